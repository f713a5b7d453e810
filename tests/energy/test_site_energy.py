"""Heartbeats of cameras whose power is known become costs and budgets."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from msgspec import structs
from tests.cases import each_case

from e3pose.edge.consumers import Consumers
from e3pose.edge.energy_ledger import EnergyLedger
from e3pose.edge.gather import Arrival
from e3pose.edge.pipeline_owner import PipelineOwner
from e3pose.energy.budgets import Budget
from e3pose.energy.modes import Look
from e3pose.energy.profiles import load_profile
from e3pose.energy.queues import Queue
from e3pose.energy.site_energy import CameraEnergy, estimate_energy, new_camera, observe
from e3pose.model.pose import Poses2D
from e3pose.pipeline import Pipeline, SlotRecord
from e3pose.select.policies.drift_plus_penalty import DriftPlusPenalty
from e3pose.store import EnergyReading
from e3pose.wire.messages import Heartbeat

PROFILE = load_profile("generic")  # 10 W active, 5.2 W in power-saving
BEAT_S = 0.5


def beats(
    count: int = 600,
    *,
    active_w: float = 7.0,
    idle_w: float = 3.0,
    session: int = 1,
    begin_s: float = 0.0,
    beat_s: float = BEAT_S,
    noise_w: float = 0.0,
    **fields: Any,
) -> Iterator[Heartbeat]:
    """Yield heartbeats of a camera with changing duty, and with these fields."""
    rng = np.random.default_rng(session)
    energy_j = active_s = idle_s = 0.0
    for number in range(count):
        yield Heartbeat(**{
            "camera_id": "c", "session": session, "mode": "active", "measured": True,
            "sent_edge_ns": round((begin_s + number * beat_s) * 1e9), "energy_j": energy_j,
            "active_s": active_s, "idle_s": idle_s, **fields,
        })  # fmt: skip
        share = rng.uniform(0.1, 0.9)
        active_s += share * beat_s
        idle_s += (1 - share) * beat_s
        energy_j += beat_s * (share * active_w + (1 - share) * idle_w + noise_w * rng.normal())


def lived(camera: CameraEnergy, **of_beats: Any) -> CameraEnergy:
    """Return a camera after heartbeats; see `beats`."""
    for beat in beats(**of_beats):
        camera = observe(camera, beat)
    return camera


def test_cost_is_learned_from_measured_heartbeats_and_from_no_others() -> None:
    camera = lived(new_camera(PROFILE))
    assert camera.beat is not None
    assert observe(camera, camera.beat) is camera  # out of order
    modelled = lived(new_camera(PROFILE), measured=False)
    slots = estimate_energy([camera, modelled], [Budget("duty", 0.5)] * 2, 0.04, 0.0, 1).slots
    assert [slot.measured for slot in slots] == [True, False]
    assert slots[0].active_j == pytest.approx(7.0 * 0.04, rel=0.02)
    assert slots[0].idle_j == pytest.approx(3.0 * 0.04, rel=0.02)
    assert slots[1].active_j == pytest.approx(10.0 * 0.04)
    assert slots[1].why.startswith("modelled")


def ledger_of(
    budgets: list[Budget], now_ns: list[int], num_selected: float = 1.0, keep: Any = None
) -> EnergyLedger:
    """Return a ledger of cameras "a", "b" and so on, with these budgets."""
    count = len(budgets)
    return EnergyLedger(
        [*"abcd"[:count]], [PROFILE] * count, ["power-saving"] * count, budgets, 0.04,
        num_selected, lambda: now_ns[0], keep,
    )  # fmt: skip


def test_recording_video_costs_slots_of_every_kind_unless_it_was_measured() -> None:
    def recorded(measured: bool) -> CameraEnergy:
        camera = new_camera(PROFILE)
        for number in range(2):
            beat = Heartbeat(
                camera_id="c", session=1, sent_edge_ns=number * 10**9, mode="active",
                energy_j=12.0 * number, measured=measured, active_s=float(number),
                recording_j=2.0 * number,
            )  # fmt: skip
            camera = observe(camera, beat)
        return camera

    (slot,) = estimate_energy([recorded(False)], [Budget("duty", 0.5)], 0.04, 0.0, 1).slots
    assert slot.active_j == pytest.approx(12.0 * 0.04) and slot.idle_j == pytest.approx(7.2 * 0.04)
    camera = lived(recorded(True), session=2)
    (slot,) = estimate_energy([camera], [Budget("duty", 0.5)], 0.04, 0.0, 1).slots
    assert slot.measured and slot.active_j == pytest.approx(7.0 * 0.04, rel=0.02)


def test_restarted_camera_goes_on_learning() -> None:
    camera = lived(lived(new_camera(PROFILE)), session=2, begin_s=400.0)
    assert camera.cost.spans == 2 * 599
    np.testing.assert_allclose(camera.cost.watts, [7.0, 3.0], rtol=0.02)


def test_a_day_of_sleeping_leaves_the_idle_power_as_it_is() -> None:
    """What is drawn asleep, 0.3 W, is part of a heartbeat's joules and of neither power."""
    camera, rng = new_camera(PROFILE), np.random.default_rng(7)
    now_s = energy_j = active_s = idle_s = asleep_s = 0.0
    for number in range(24 * 600):
        share, rest_s = rng.uniform(0.1, 0.9), float(number % 3 == 0) * rng.uniform(4, 12)
        active_s += share * BEAT_S
        idle_s += (1 - share) * BEAT_S
        asleep_s += rest_s
        now_s += BEAT_S + rest_s
        drawn_w = share * 7.0 + (1 - share) * 3.0 + 0.2 * rng.normal()
        energy_j += BEAT_S * drawn_w + 0.3 * rest_s
        beat = Heartbeat(
            "c", 1, round(now_s * 1e9), "active", energy_j=energy_j, measured=True,
            active_s=active_s, idle_s=idle_s, asleep_s=asleep_s,
        )  # fmt: skip
        camera = observe(camera, beat)
        if number > 600:
            assert np.abs(camera.cost.watts / [7.0, 3.0] - 1).max() < 0.03


def test_budgets_follow_what_was_learned_and_the_batteries() -> None:
    cameras = [
        lived(new_camera(PROFILE), battery_j=5.0 * 3600),
        lived(new_camera(PROFILE), battery_j=5.0 * 3600, charging_w=1.0),
        lived(new_camera(PROFILE)),
    ]
    estimate = estimate_energy(cameras, [Budget("until", 3600.0)] * 3, 0.04, 0.0, 2)
    # 5 W of a camera that draws 3 to 7: half of the slots; a watt of sun pays for a quarter more.
    np.testing.assert_allclose(estimate.budget, [0.5, 0.75, 1.0], atol=0.02)
    np.testing.assert_allclose(estimate.cost_j, 0.16, rtol=0.03)
    np.testing.assert_allclose(
        estimate.spent_j(np.array([True, False, True])), [0.28, 0.12, 0.28], rtol=0.03
    )


def test_a_cloud_is_no_evening() -> None:
    sunny = lived(new_camera(PROFILE), battery_j=1000.0, charging_w=4.0)
    cloud = lived(sunny, battery_j=1000.0, begin_s=300.0, count=60)  # half a minute
    assert 3.5 < cloud.supply().charging_w < 4.0
    evening = lived(sunny, battery_j=1000.0, begin_s=300.0, count=7200)
    assert evening.supply().charging_w < 0.05


def test_ledger_takes_heartbeats_and_estimates_every_minute() -> None:
    now_ns, kept = [0], list[EnergyReading]()
    ledger = ledger_of([Budget("watts", 5.0)] * 2, now_ns, keep=kept.append)
    before, new = ledger.estimate()
    assert new, "the first holds from the beginning"
    assert not ledger.estimate()[1]
    assert [slot.measured for slot in before.slots] == [False, False]
    for beat in beats(200):
        now_ns[0] = beat.sent_edge_ns
        for camera_id in ("a", "stranger"):
            ledger.take(structs.replace(beat, camera_id=camera_id))
    after, new = ledger.estimate()
    assert new
    assert [slot.measured for slot in after.slots] == [True, False]
    np.testing.assert_allclose(after.budget[0], 0.5, atol=0.02)  # 5 W between 3 and 7
    assert not ledger.estimate()[1]
    np.testing.assert_allclose(ledger.charge(np.array([True, True])), [0.28, 0.4], rtol=0.02)
    assert len(kept) == 199
    assert sum(reading.energy_j for reading in kept) == pytest.approx(beat.energy_j)
    assert {reading.source for reading in kept} == {"measured"}
    assert {reading.span_s for reading in kept} == {BEAT_S}


def test_pipeline_follows_the_estimate() -> None:
    """A battery that does not pay for two cameras per slot gets fewer, and other budgets."""
    now_ns = [0]
    ledger = ledger_of([Budget("until", 3600.0)] * 2, now_ns, 2)
    pipeline = Pipeline(
        rig=cast(Any, SimpleNamespace(titles={"a": "Küche", "b": "b"})), num_joints=17,
        interval_s=0.04, estimator=cast(Any, None),
        predictor=cast(Any, None), policy=DriftPlusPenalty(2), queue=Queue(np.ones(2)),
        clock=lambda: 0.0, waking=DriftPlusPenalty,
    )  # fmt: skip
    owner, consumers, record = PipelineOwner(pipeline), Consumers(ledger=ledger), cast(Any, None)
    assert owner.after_slot(consumers, record) == []
    on_mains = owner.pipeline
    np.testing.assert_array_equal(on_mains.queue.budget, [1.0, 1.0])
    assert on_mains.policy == DriftPlusPenalty(2)
    owner.after_slot(consumers, record)
    assert owner.pipeline is on_mains, "nothing changes within a minute"
    for beat in beats(300):
        now_ns[0] = beat.sent_edge_ns
        left_j = 5.0 * (3600 - now_ns[0] / 1e9)
        for camera_id in "ab":
            ledger.take(structs.replace(beat, camera_id=camera_id, battery_j=left_j))
    news = owner.after_slot(consumers, record)
    changed = owner.pipeline
    np.testing.assert_allclose(changed.queue.budget, 0.5, atol=0.02)  # 5 W between 3 and 7
    assert isinstance(changed.policy, DriftPlusPenalty)
    assert changed.policy.num_selected == pytest.approx(0.95, abs=0.04)
    assert changed.queue.cost_j is not None
    np.testing.assert_allclose(changed.queue.cost_j, 0.16, rtol=0.03)
    assert [camera_id for _, _, camera_id in news] == ["a", "b", None]
    assert "measured" in news[0][1] and news[0][1].startswith("Küche: ")
    assert re.fullmatch(r"budgets allow 0\.9\d cameras per slot, 2 requested", news[2][1])


def test_battery_that_cannot_last_is_reported_once() -> None:
    """4 W for a camera that draws 5.2 W when idle."""
    now_ns = [0]
    ledger = ledger_of([Budget("watts", 4.0), Budget("duty", 1)], now_ns)
    _, news = ledger.updated()
    ((camera_id, line),) = news
    assert camera_id == "a"
    assert "budget below its idle power of 5.2 W" in line
    now_ns[0] = 61 * 10**9
    assert ledger.updated()[1] == []


def other_power(times: float) -> CameraEnergy:
    """Return a camera whose meter says so many times the power of the others."""
    return lived(new_camera(PROFILE), active_w=7.0 * times, idle_w=3.0 * times, count=600)


@each_case("times", [1e-9, 0.1, 5.0, 1e9])
@each_case("liars", [1, 2])
def test_made_up_costs_do_not_change_the_price_of_others(times: float, liars: int) -> None:
    cameras = [*[lived(new_camera(PROFILE))] * (4 - liars), *[other_power(times)] * liars]
    estimate = estimate_energy(cameras, [Budget("duty", 0.5)] * 4, 0.04, 0.0, 2)
    relative = estimate.cost_j / estimate.cost_j.mean()
    np.testing.assert_allclose(relative[: 4 - liars], 1.0, rtol=0.05)
    np.testing.assert_allclose(estimate.budget[: 4 - liars], 0.5)


def test_costs_half_learned_do_not_change_the_price_of_others() -> None:
    """A camera of which little is measured costs what its likes do, not what it seems to so far."""
    vague = lived(new_camera(PROFILE), active_w=5.5, idle_w=3.0, count=8)
    cameras = [*[lived(new_camera(PROFILE))] * 3, vague]
    estimate = estimate_energy(cameras, [Budget("duty", 0.5)] * 4, 0.04, 0.0, 2)
    assert [slot.measured for slot in estimate.slots] == [True] * 3 + [False]
    np.testing.assert_allclose(estimate.cost_j, estimate.cost_j[0])


def test_meters_that_drift_never_move_what_the_other_half_costs() -> None:
    """Of two cameras one, of four two: in days their meters come to say five times as much."""
    true = drifting = lived(new_camera(PROFILE))
    for hour in range(1, 72):
        times = 5.0 ** (hour / 72)
        drifting = lived(
            drifting, active_w=7.0 * times, idle_w=3.0 * times, count=60, session=1 + hour,
            begin_s=3600.0 * hour, beat_s=60.0, noise_w=0.1,
        )  # fmt: skip
        for half in (1, 2):
            cameras = [*[drifting] * half, *[true] * half]
            budgets = [Budget("duty", 0.5)] * len(cameras)
            cost_j = estimate_energy(cameras, budgets, 0.04, 0.0, 1).cost_j
            np.testing.assert_allclose(cost_j[half:], 0.16, rtol=0.03)
            if not 1.7 < times < 2.3:
                believed = times if times < 2 else 1.0
                np.testing.assert_allclose(cost_j[:half], 0.16 * believed, rtol=0.1)


def test_devices_that_all_differ_from_their_profile_are_believed() -> None:
    estimate = estimate_energy([other_power(0.3)] * 3, [Budget("duty", 0.5)] * 3, 0.04, 0.0, 2)
    np.testing.assert_allclose(estimate.cost_j, 0.3 * 0.16, rtol=0.05)


def test_no_battery_holds_more_than_its_capacity() -> None:
    boasting = lived(new_camera(PROFILE, capacity_j=3600.0), battery_j=1e12)
    assert boasting.supply().battery_j == 3600.0
    together = [Budget("together")] * 3
    cameras = [lived(new_camera(PROFILE, capacity_j=3600.0), battery_j=3600.0)] * 2
    estimate = estimate_energy([*cameras, boasting], together, 0.04, 0.0, 1.5)
    np.testing.assert_allclose(estimate.budget, 0.5, atol=0.02)


class Sink:
    """Keeps what slots are charged with."""

    def __init__(self) -> None:
        self.energy_j = list[Any]()

    def append(self, record: SlotRecord, time_ns: int, energy_j: Any = None) -> None:
        self.energy_j.append(energy_j)

    def status(self) -> None:
        """Say nothing."""


def test_a_look_whose_image_was_unchanged_is_charged_an_idle_slot_and_the_gate() -> None:
    gated = replace(PROFILE, looks=(Look("gate", 0.01, 0.002),))
    ledger = EnergyLedger(
        ["a", "b", "c", "d"], [gated, PROFILE, gated, gated], ["power-saving"] * 4,
        [Budget("duty", 1.0)] * 4, 0.04, 1, lambda: 0,
    )  # fmt: skip
    sink = Sink()
    consumers = Consumers(ledger=ledger, sink=cast(Any, sink))
    found = Poses2D.empty(17)
    still = replace(found, unchanged_s=0.5)
    arrivals = {camera: Arrival(still, 0, 0) for camera in (0, 1, 3)} | {2: Arrival(found, 0, 0)}
    seen = SimpleNamespace(selected=np.array([True, True, True, False]), blind="")
    record = cast(SlotRecord, seen)
    assert consumers.saving is None
    consumers.keep(record, 0, arrivals)
    look_j, idle_j = 10.0 * 0.04, 5.2 * 0.04
    # A profile without the row says nothing of the gate; a look that nobody ordered costs nothing.
    np.testing.assert_allclose(sink.energy_j[-1], [idle_j + 0.01, idle_j, look_j, idle_j])
    consumers.keep(record, 0)  # no view came: charged as ordered
    np.testing.assert_allclose(sink.energy_j[-1], [look_j, look_j, look_j, idle_j])
    saved = consumers.saving
    assert saved is not None and saved.basis == "modelled"
    assert saved.always == pytest.approx(8 * look_j)
    assert saved.spent == pytest.approx(4 * idle_j + 0.01 + 4 * look_j)
    consumers.keep(cast(SlotRecord, SimpleNamespace(selected=seen.selected, blind="views-late")), 0)
    assert consumers.saving == saved, "nothing is saved in a blind slot"


def test_the_gate_never_costs_more_than_a_look() -> None:
    dear = replace(PROFILE, looks=(Look("gate", 9.0, 0.002),))
    ledger = EnergyLedger(
        ["a"], [dear], ["power-saving"], [Budget("duty", 1.0)], 0.04, 1, lambda: 0
    )
    one = np.array([True])
    np.testing.assert_allclose(ledger.charge(one, one), ledger.charge(one))
