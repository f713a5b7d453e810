"""Active time and spending of a camera, to the edge's ledger, by a clock moved."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case
from tests.manual_clock import ManualClock
from tests.memory_transport import Hub
from tests.waiting import eventually

from e3pose.base.clock import SlotTimes
from e3pose.camera.base import LiveFrame, LiveSource, NodeSettings
from e3pose.camera.live import SLOT_WAIT_S, Box, CameraNode, Spending, pause_ns
from e3pose.camera.schedule import Schedule
from e3pose.edge.energy_ledger import EnergyLedger
from e3pose.energy.activity import ModeClock
from e3pose.energy.budgets import Budget
from e3pose.energy.meters.base import Reading
from e3pose.energy.meters.sampler import PowerSampler
from e3pose.energy.profiles import load_profile
from e3pose.model.pose import Poses2D
from e3pose.select.policies.base import Policy
from e3pose.select.policies.fixed import Random, RoundRobin
from e3pose.wire import topics
from e3pose.wire.codec import decode
from e3pose.wire.messages import Heartbeat
from e3pose.wire.offset import Offset, OffsetEstimate

pytestmark = pytest.mark.slow

ACTIVE_W, IDLE_W = 8.0, 3.0
JOINTS = tuple(map(str, range(17)))
BEGIN_NS = 10**18


class PassingClock(ManualClock):
    """Takes 20 us to read, and waits by moving itself."""

    def now_ns(self) -> int:
        self.time_ns += 20_000
        return self.time_ns

    def wait(self, event: threading.Event, until_ns: int) -> bool:
        self.time_ns = max(self.time_ns, until_ns)
        return event.is_set()


@dataclass
class Network:
    """Finds nobody, and notes when it was run."""

    clock: ManualClock
    begun_ns: list[int] = field(default_factory=list)

    def looks(self, look_s: float) -> bool:
        """Return whether a look goes on."""
        return bool(self.begun_ns) and self.clock.now_ns() < self.begun_ns[-1] + look_s * 1e9

    def detect(self, image: Any) -> Poses2D:
        self.begun_ns.append(self.clock.now_ns())
        return Poses2D.empty(len(JOINTS))


@dataclass
class ExactMeter:
    """Counts what idling draws, and what looks draw beyond it, each within `look_s`."""

    network: Network
    slot_s: float
    look_s: float
    counted_j: float = 0.0

    def read(self, mode: object) -> Reading:
        now_ns, begun_ns = self.network.clock.now_ns(), self.network.begun_ns
        newest_s = (now_ns - np.array(begun_ns[-9:])) / 1e9
        looks = len(begun_ns) - float(np.clip(1 - newest_s / self.look_s, 0, 1).sum())
        total_j = IDLE_W * (now_ns - BEGIN_NS) / 1e9
        total_j += (ACTIVE_W - IDLE_W) * self.slot_s * looks
        spent_j, self.counted_j = total_j - self.counted_j, total_j
        return Reading(0.0, spent_j, True, "measured: a test")


class Site:
    """Cameras with one frame a slot, and an edge that hears their heartbeats."""

    def __init__(self, fps: float, cameras: int, look_share: float, gate: bool = False) -> None:
        self.rng, self.clock, self.slot_s = (
            np.random.default_rng(5),
            PassingClock(BEGIN_NS),
            1 / fps,
        )
        self.times = SlotTimes(BEGIN_NS + 10**9, round(1e9 / fps))
        self.networks = [Network(self.clock) for _ in range(cameras)]
        self.nodes = []
        for index, network in enumerate(self.networks):
            modes = ModeClock(self.clock.now_ns)
            meter = PowerSampler(ExactMeter(network, 1 / fps, look_share / fps), modes)
            settings = NodeSettings("lab", f"cam{index}", JOINTS, gate=gate)
            source: LiveSource = SimpleNamespace(fps=fps)
            more = network, Hub().join(), self.clock, meter
            node = CameraNode(settings, source, *more, modes=modes)
            node._spending = Spending(modes, meter, partial(network.looks, look_share / fps))
            self.nodes.append(node)
        self.due_ns = [BEGIN_NS] * cameras

    def run(self, policy: Policy, ledger: EnergyLedger, slots: range, image: Any = None) -> None:
        """Let slots pass; images are the same where one is given."""
        online = np.ones(len(self.nodes), dtype=bool)
        for slot in slots:
            situation: Any = SimpleNamespace(slot=slot, online=online)
            selected = policy.select(situation)
            late_ns = np.sort(np.abs(self.rng.normal(0, 2e6, len(self.nodes)))).astype(int)
            for camera in self.rng.permutation(len(self.nodes)):
                now_ns = self.times.middle_ns(slot) + int(late_ns[camera])
                self.clock.time_ns = max(now_ns, self.clock.time_ns)
                self._frame(camera, slot, bool(selected[camera]), ledger, image)

    def _frame(
        self, camera: int, slot: int, active: bool, ledger: EnergyLedger, image: Any
    ) -> None:
        node, now_ns = self.nodes[camera], self.clock.now_ns()
        if now_ns >= self.due_ns[camera]:  # what `by_next_slot` does on a thread of its own
            node._spending.told.clear()
        node.schedule = Schedule(session=1, times=self.times, active={slot: active})
        node._take(LiveFrame(now_ns, (640, 480), lambda: image))
        if node._spending._taken:
            ledger.take(node._heartbeat(node._spending._taken.pop()))
            self.due_ns[camera] = now_ns + pause_ns(self.rng.random())
        if active:
            seen = node._frames.take()
            assert seen is not None and seen.slot == slot
            node._look(seen)

    def active_s(self, camera: int) -> float:
        return float(self.nodes[camera].modes.times().fields()["active_s"])


def make_ledger(site: Site, budgets: list[Budget], count: float) -> EnergyLedger:
    names, profile = [node.settings.camera_id for node in site.nodes], load_profile("generic")
    cameras = len(names)
    return EnergyLedger(
        names, [profile] * cameras, ["power-saving"] * cameras, budgets, site.slot_s, count,
        site.clock.now_ns,
    )  # fmt: skip


@each_case(
    ("cameras", "count", "policy", "look_share"),
    [
        (5, 2, RoundRobin, 0.2),
        (4, 2, Random, 1.0),
        (4, 1, RoundRobin, 1.5),  # slots
    ],
)
def test_exact_meter_is_learned_in_two_minutes_and_pays_for_what_budgets_say(
    cameras: int, count: int, policy: type[RoundRobin | Random], look_share: float
) -> None:
    fps = 30.0  # a slot is no whole number of nanoseconds
    site = Site(fps, cameras, look_share)
    watts, share = Budget("watts", 4.5), Budget("duty", 0.3)
    ledger = make_ledger(site, [watts, share] * (cameras // 2) + [watts] * (cameras % 2), count)
    slots = round(120 * fps)
    site.run(policy(count), ledger, range(slots))
    estimate, _ = ledger.estimate()
    for camera, (slot, network) in enumerate(zip(estimate.slots, site.networks, strict=True)):
        looks = len(network.begun_ns)
        assert looks == pytest.approx(slots * count / cameras, rel=0.1)
        assert site.active_s(camera) == pytest.approx(looks * site.slot_s)
        assert slot.measured
        assert slot.active_j == pytest.approx(ACTIVE_W * site.slot_s, rel=0.03)
        assert slot.idle_j == pytest.approx(IDLE_W * site.slot_s, rel=0.03)
    np.testing.assert_allclose(estimate.budget, 0.3, atol=0.01)


def test_budgets_that_were_learned_to_pay_for_a_share_of_slots_keep_it() -> None:
    site = Site(25.0, 4, look_share=0.6)
    ledger = make_ledger(site, [Budget("watts", 4.5), Budget("duty", 0.3)] * 2, 2)
    looked = np.zeros(4)
    for minute in range(3):
        estimate, new = ledger.estimate()
        assert new
        count = estimate.num_selected if minute == 2 else 2.0
        before = np.array([len(network.begun_ns) for network in site.networks])
        site.run(RoundRobin(count), ledger, range(1505 * minute, 1505 * (minute + 1)))
        looked = np.array([len(network.begun_ns) for network in site.networks]) - before
    np.testing.assert_allclose(looked / 1505, 0.3, atol=0.01)


def test_camera_in_whose_time_between_looks_the_share_of_looks_is_constant_stays_modelled() -> None:
    site = Site(25.0, 4, look_share=1.5)  # of every second slot: only between two of these
    ledger = make_ledger(site, [Budget("duty", 1.0)] * 4, 2)
    site.run(RoundRobin(2), ledger, range(3000))
    estimate, _ = ledger.estimate()
    for slot in estimate.slots:
        assert not slot.measured
        mean_w = (slot.active_j + slot.idle_j) / 2 / site.slot_s
        assert mean_w == pytest.approx((ACTIVE_W + IDLE_W) / 2, rel=0.02)


def test_slots_that_the_motion_gate_finds_unchanged_are_idle() -> None:
    site = Site(25.0, 2, look_share=1.0, gate=True)
    ledger = make_ledger(site, [Budget("duty", 1.0)] * 2, 1)
    image = np.full((45, 80, 3), 90, np.uint8)
    site.run(RoundRobin(1), ledger, range(500), image)
    node = site.nodes[0]
    assert node.counts.unchanged + node.counts.detected == 250
    assert 0 < node.counts.detected < 50
    assert site.active_s(0) == pytest.approx(node.counts.detected * 0.04)


class LooksAt:
    """Lets a camera look in some slots."""

    def __init__(self, *slots: int) -> None:
        self.slots = slots

    def select(self, situation: Any) -> Any:
        return np.array([situation.slot in self.slots])


def test_camera_that_falls_asleep_after_each_look_is_learned_in_two_minutes() -> None:
    rng, site = np.random.default_rng(0), Site(25.0, 1, look_share=0.6)
    ledger = make_ledger(site, [Budget("watts", 4.5)], 1)
    (node,) = site.nodes
    node.settings = replace(node.settings, rests=("asleep",))
    node.offset = OffsetEstimate(offset=Offset(error_ns=0))
    topic = topics.of_camera("lab", "cam0", "heartbeat")
    node.transport.subscribe(topic, lambda _, sent: ledger.take(decode(sent, Heartbeat, "cam0")))
    slot = 0
    while slot < 3000:
        last = slot + int(rng.integers(20, 40))
        policy: Any = LooksAt(*[last, last - 3][: rng.integers(1, 3)])
        site.run(policy, ledger, range(slot, last + 1))
        slot = last + int(rng.integers(75, 225))
        node.schedule = replace(node.schedule, asleep_from=last + 1, asleep_until=slot)
        site.clock.advance(site.slot_s)
        assert node._alarm_ns() is None, "a look goes on"
        node._frames._dealing = False  # as if the thread that looks came back for the next
        node._sleep(node._alarm_ns() or 0)
        assert site.clock.now_ns() > site.times.begin_ns(last + 50)
    assert 15 < len(site.networks[0].begun_ns) < 40
    estimate, _ = ledger.estimate()
    assert estimate.slots[0].measured
    assert estimate.slots[0].active_j == pytest.approx(ACTIVE_W * site.slot_s, rel=0.03)
    assert estimate.budget[0] == pytest.approx(0.3, abs=0.01)


SLOT_NS = 40_000_000


def test_what_was_spent_is_taken_before_the_look_of_the_slot_that_begins() -> None:
    clock, found = ManualClock(), list[dict[str, Any]]()
    modes = ModeClock(clock.now_ns)
    spending = Spending(modes, lambda mode: {"energy_j": clock.now_ns() / 1e9})
    spending.begin_slot(active=True)  # nobody waits
    modes.look(0, SLOT_NS)
    waiting = threading.Thread(target=lambda: found.append(spending.by_next_slot()))
    waiting.start()
    assert eventually(lambda: not spending.told.is_set())
    clock.advance(0.04)
    spending.begin_slot(active=True)
    modes.look(clock.now_ns(), SLOT_NS)
    clock.advance(0.03)
    waiting.join()
    assert found == [
        {"mode": "active", "active_s": 0.04, "idle_s": 0.0, "asleep_s": 0.0, "energy_j": 0.04}
    ]


def test_camera_without_frames_says_what_it_spent_all_the_same() -> None:
    clock = ManualClock()
    modes = ModeClock(clock.now_ns)
    spending = Spending(modes, lambda mode: {})
    modes.change("aggressive-power-saving")
    clock.advance(SLOT_WAIT_S)
    for _ in range(2):
        spent = spending.by_next_slot()
        assert (spent["mode"], spent["idle_s"]) == ("aggressive-power-saving", SLOT_WAIT_S)

    def meter(mode: object) -> dict[str, Any]:
        clock.advance(0.003)
        return {**modes.times().fields(), "energy_j": 1.0}

    # Times that a meter took itself replace those before it was read.
    assert Spending(modes, meter).now()["idle_s"] == pytest.approx(SLOT_WAIT_S + 0.003)


def test_nothing_is_taken_while_a_look_goes_on_unless_it_never_ends() -> None:
    clock, looking, found = ManualClock(), [True], list[dict[str, Any]]()
    modes = ModeClock(clock.now_ns)
    spending = Spending(modes, lambda mode: {"energy_j": clock.now_ns() / 1e9}, lambda: looking[0])
    spending.told.clear()
    spending.begin_slot(active=True)
    assert not spending.told.is_set() and not spending._taken
    assert spending.by_next_slot()["energy_j"] == 0.0
    waiting = threading.Thread(target=lambda: found.append(spending.by_next_slot()))
    waiting.start()
    assert eventually(lambda: not spending.told.is_set())
    clock.advance(0.04)
    looking[0] = False
    spending.begin_slot(active=False)
    clock.advance(0.04)
    waiting.join()
    assert [spent["energy_j"] for spent in found] == [0.04]


def test_a_look_goes_on_from_when_its_frame_is_put_until_the_next_is_taken() -> None:
    box = Box[int]()
    assert not box.busy
    box.put(1)
    assert box.busy and box.take() == 1 and box.busy
    taking = threading.Thread(target=box.take)
    taking.start()
    assert eventually(lambda: not box.busy)
    box.close()
    taking.join()


def test_number_of_slots_between_heartbeats_varies() -> None:
    pauses_ns = [pause_ns(draw / 10) for draw in range(10)]
    assert min(pauses_ns) > 0.3e9 and max(pauses_ns) < 0.6e9
    assert max(pauses_ns) - min(pauses_ns) > 3 * SLOT_NS
