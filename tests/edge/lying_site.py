"""A site in simulated time: an edge without threads, cameras of which some lie, and the outcome.

Nothing waits: time jumps to the next message. The edge is the real one, from its inbox to its
send queue, with its energy ledger and a stand-in for recorder and store that keep what they get.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from tests.manual_clock import ManualClock
from tests.memory_transport import Hub

from e3pose.base.clock import SlotTimes
from e3pose.edge.consumers import Consumers
from e3pose.edge.energy_ledger import EnergyLedger
from e3pose.edge.gather import Arrival, Gather
from e3pose.edge.processor_times import ProcessorTimes
from e3pose.edge.server import EdgeServer
from e3pose.energy.budgets import Budget
from e3pose.energy.profiles import load_profile
from e3pose.model.pose import Poses2D
from e3pose.recording import Recording
from e3pose.recording.json_lines import encode_view
from e3pose.settings.edge import EdgeSettings
from e3pose.settings.loop import ReplaySettings
from e3pose.settings.parts import make_pipeline
from e3pose.simulate.settings import SceneSettings
from e3pose.simulate.simulation import simulate
from e3pose.store.rows import EnergyReading
from e3pose.wire.arrays import pack_poses, unpack
from e3pose.wire.codec import decode, encode
from e3pose.wire.messages import CameraMode, ClockQuestion, Heartbeat, Hello, Order, View
from e3pose.wire.site_messages import Poses, Status
from lies import HONEST, Lie, LyingTransport

FPS = 10.0
BEGIN_NS = 1_795_000_000 * 10**9
LINK_NS, DETECT_NS = 8_000_000, 15_000_000
DEADLINE_S = 0.12
LIES_AFTER_S = 4.0
LOST_M = 0.5  # error of somebody who is not found


@cache
def scene(cameras: int) -> Recording:
    return simulate(SceneSettings("ring", people=2, seconds=10.0, fps=FPS, cameras=cameras), seed=2)


def _here(recording: Recording, time_ns: int) -> int:
    """Return what is seen at a time. After the last slot, people go back as they came."""
    last = recording.num_slots - 1
    here = (time_ns - BEGIN_NS) * round(FPS) // 10**9 % (2 * last)
    return min(here, 2 * last - here)


@dataclass(eq=False)
class Air:
    """What is under way, by the time at which it arrives."""

    clock: ManualClock
    _due: list[tuple[int, int, Callable[[], None]]] = field(default_factory=list)
    _count: itertools.count[int] = field(default_factory=itertools.count)

    def after(self, ns: int, act: Callable[[], None]) -> None:
        heapq.heappush(self._due, (self.clock.time_ns + ns, next(self._count), act))

    def next_until(self, until_ns: int) -> bool:
        """Let the next thing happen, if it happens before a time; return whether one did."""
        if not self._due or self._due[0][0] > until_ns:
            self.clock.time_ns = max(self.clock.time_ns, until_ns)
            return False
        at_ns, _, act = heapq.heappop(self._due)
        self.clock.time_ns = max(self.clock.time_ns, at_ns)
        act()
        return True


class SimulatedGather(Gather):
    """Waits by letting things happen."""

    air: Air

    def sleep(self, clock: object, until_ns: int, awaited: Collection[int] = ()) -> None:
        self.air.next_until(until_ns)


@dataclass(eq=False)
class SimulatedCamera:
    """A camera that does what it is ordered to, on time; what it says goes through a liar."""

    index: int
    recording: Recording
    air: Air
    transport: LyingTransport
    session: int = 7
    wake_s: float = 0.4
    orders: int = 0
    late: int = 0
    sent: int = 0
    active_s: float = 0.0
    delay_ns: int = 0
    beat_ns: int = 500_000_000
    beats_per_hello: int = 4
    slots: set[int] = field(default_factory=set)  # ordered

    @property
    def camera_id(self) -> str:
        return self.recording.rig.camera_ids[self.index]

    def topic(self, what: str) -> str:
        return f"e3pose/lab/camera/{self.camera_id}/{what}"

    def begin(self) -> None:
        self.transport.be_present(self.topic("alive"))
        self.beat(0)

    def beat(self, number: int) -> None:
        now_ns = self.air.clock.time_ns
        if number % self.beats_per_hello == 0:
            size = self.recording.rig.cameras[self.index].image_size
            joints = self.recording.skeleton.joints
            hello = Hello(self.camera_id, self.session, joints, size, FPS, self.wake_s)
            self.transport.publish(self.topic("hello"), encode(hello))
        question = encode(ClockQuestion(self.camera_id, now_ns))
        self.transport.ask(self.topic("clock"), question, 1.0)
        seconds = (now_ns - BEGIN_NS) / 1e9
        beat = Heartbeat(
            self.camera_id, self.session, now_ns, "active", captured=number + 1,
            detected=self.sent, sent=self.sent, late_orders=self.late, orders=self.orders,
            clock_error_ns=1_000_000, power_w=8.0, measured=True,
            energy_j=5.2 * seconds + 4.8 * self.active_s, active_s=self.active_s,
            idle_s=seconds - self.active_s, battery_j=1e5, order_delay_ns=self.delay_ns,
        )  # fmt: skip
        self.delay_ns = 0
        self.transport.publish(self.topic("heartbeat"), encode(beat))
        self.air.after(self.beat_ns, lambda: self.beat(number + 1))

    def take(self, payload: bytes) -> None:
        order, now_ns = decode(payload, Order, "edge"), self.air.clock.time_ns
        times = SlotTimes(order.origin_edge_ns, order.interval_ns)
        self.orders += 1
        self.delay_ns = max(self.delay_ns, now_ns - times.middle_ns(order.slot - order.lead))
        if now_ns > times.begin_ns(order.slot):
            self.late += 1
        elif order.active and order.slot not in self.slots:
            self.slots.add(order.slot)
            seen_ns = times.middle_ns(order.slot)
            self.active_s += order.interval_ns / 1e9
            wait_ns = seen_ns - now_ns + DETECT_NS + 1_000_000 * self.index + LINK_NS
            self.air.after(wait_ns, lambda: self.send(order.slot, seen_ns))

    def send(self, slot: int, seen_ns: int) -> None:
        poses = self.recording.views[self.index].view(_here(self.recording, seen_ns))
        poses = Poses2D.empty(len(self.recording.skeleton)) if poses is None else poses
        now_ns = self.air.clock.time_ns
        view = View(
            self.camera_id, self.session, slot, seen_ns, *pack_poses(poses), 1_000_000, DETECT_NS,
            now_ns,
        )  # fmt: skip
        self.sent += 1
        self.transport.publish(self.topic("view"), encode(view))


@dataclass(eq=False)
class Kept:
    """What the honest cameras' users get.

    Attributes:
        leads: by slot.
        latencies_s: by slot, from its middle to its poses.
        people: by slot.
        errors_m: by slot, from joints of people to those of the nearest pose, `LOST_M` at most.
        views: by slot, how many of honest cameras were used.
        others: by slot, how many of liars.
        lines: recorded views.
        readings: rows of energy, with the time at which they came.
        price: `(num_honest,)` relative cost of active slots at the end.
        budget: `(num_honest,)` at the end.
        deficit: `(num_honest,)` largest.
        events: reported.
    """

    leads: list[int] = field(default_factory=list)
    latencies_s: list[float] = field(default_factory=list)
    people: list[int] = field(default_factory=list)
    errors_m: list[float] = field(default_factory=list)
    views: list[int] = field(default_factory=list)
    others: list[int] = field(default_factory=list)
    lines: int = 0
    readings: list[tuple[int, EnergyReading]] = field(default_factory=list)
    price: tuple[float, ...] = ()
    budget: tuple[float, ...] = ()
    deficit: tuple[float, ...] = ()
    events: int = 0


def _error_m(recording: Recording, poses: Poses) -> float:
    """Return the mean distance from people's joints to those of the nearest pose."""
    assert recording.truth is not None
    true_m = recording.truth.joints_m[_here(recording, poses.time_edge_ns)]
    found_m = unpack(poses.joints_m)
    apart_m = np.linalg.norm(true_m[:, None] - found_m[None], axis=-1)
    nearest_m = np.nan_to_num(apart_m, nan=LOST_M).mean(axis=-1).min(axis=1, initial=LOST_M)
    return float(nearest_m.mean())


@dataclass(eq=False)
class _Recorder:
    kept: Kept
    camera_ids: Sequence[str]
    processor: ProcessorTimes = field(default_factory=lambda: ProcessorTimes(FPS))

    def keep(self, slot: int, time_ns: int, arrivals: Mapping[int, Arrival]) -> None:
        for arrival in arrivals.values():
            encode_view(slot, (arrival.captured_ns - BEGIN_NS) / 1e9, arrival.poses)
            self.kept.lines += 1


def run(
    lie: Lie = HONEST,
    liars: int = 1,
    seconds: float = 20.0,
    cameras: int = 4,
    idle_mode: CameraMode = "power-saving",
    talkative: bool = False,
    link_s: Callable[[float], float] = lambda since_s: LINK_NS / 1e9,
) -> Kept:
    """Return what a site gave while its last cameras lied.

    Args:
        lie: what they say.
        liars: how many of them.
        seconds: simulated.
        cameras: in all.
        idle_mode: of all cameras.
        talkative: whether cameras send heartbeats twice as often, and a hello with each.
        link_s: what orders to the liars take, by the seconds since they began to lie.
    """
    recording, clock, hub, kept = scene(cameras), ManualClock(BEGIN_NS), Hub(), Kept()
    air = Air(clock)
    ids = recording.rig.camera_ids
    profile = load_profile("generic")
    ledger = EnergyLedger(
        ids, [profile] * cameras, [idle_mode] * cameras, [Budget("duty", 0.6)] * cameras,
        1 / FPS, 2.0, clock.now_ns, lambda row: kept.readings.append((clock.time_ns, row)),
    )  # fmt: skip
    loop = ReplaySettings(
        pipeline="memory", policy="information", num_selected=2, predictor="zero-velocity"
    )
    settings = EdgeSettings(
        "lab", recording.skeleton, DEADLINE_S, [idle_mode] * cameras, wakes_s=[0.4] * cameras
    )
    recorder = _Recorder(kept, ids)
    consumers = Consumers(ledger=ledger, recorder=recorder)  # type: ignore[arg-type]
    edge = EdgeServer(
        make_pipeline(recording, loop), hub.join(), settings, clock, consumers=consumers
    )
    gather = SimulatedGather(cameras)
    gather.air = air
    edge.gather = edge.inbox.gather = gather
    edge.ready = True  # kernels are compiled where they are called
    edge.membership.join()
    made = [
        SimulatedCamera(index, recording, air, LyingTransport(hub.join(), seed=index))
        for index in range(cameras)
    ]
    for camera in made if talkative else []:
        camera.beat_ns, camera.beats_per_hello = 250_000_000, 1
    by_topic = {f"e3pose/lab/order/{camera.camera_id}": camera for camera in made}
    honest = cameras - liars

    def publish(topic: str, payload: bytes, slot: int) -> None:
        if (camera := by_topic.get(topic)) is not None:
            since_s = (clock.time_ns - BEGIN_NS) / 1e9 - LIES_AFTER_S
            lies = since_s >= 0 and camera.index >= honest
            air.after(
                round(link_s(since_s) * 1e9) if lies else LINK_NS, lambda: camera.take(payload)
            )
        elif topic.endswith("/poses"):
            poses = decode(payload, Poses, "edge")
            kept.latencies_s.append((clock.time_ns - poses.time_edge_ns) / 1e9)
            kept.people.append(poses.track_ids.shape[0])
            kept.errors_m.append(_error_m(recording, poses))
            kept.views.append(sum(camera_id in ids[:honest] for camera_id in poses.arrived))
            kept.others.append(len(poses.arrived) - kept.views[-1])
        elif topic.endswith("/status"):
            decode(payload, Status, "edge")  # viewers can read it

    for camera in made:
        camera.begin()
    air.next_until(BEGIN_NS)
    times = edge.times = edge._begin()
    deficits = np.zeros(honest)
    begun = False
    while clock.time_ns < BEGIN_NS + seconds * 1e9:
        if (
            not begun and clock.time_ns > BEGIN_NS + LIES_AFTER_S * 1e9
        ):  # they seem honest until they are trusted
            begun = True
            for camera in made[honest:]:
                camera.transport.lie = lie
        slot = edge.state.slot
        edge._wait_for_views(times, slot)
        edge._compute(times, slot, edge.gather.close())
        edge.housekeeping.look()
        edge.send_queue.send_waiting(publish)
        kept.leads.append(edge.lead.slots)
        deficits = np.maximum(deficits, edge.state.deficit[:honest])
    ledger.change([Budget("duty", 0.6)] * cameras, 2.0)  # makes a new estimate
    estimate = ledger.estimate()[0]
    kept.price = tuple((estimate.cost_j / estimate.cost_j.mean())[:honest].tolist())
    kept.budget = tuple(estimate.budget[:honest].tolist())
    kept.deficit = tuple(deficits.tolist())
    kept.events = len(edge.event_log.recent)
    return kept
