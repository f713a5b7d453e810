"""Orders become modes, and frames become slots."""

from __future__ import annotations

import numpy as np
import pytest

from e3pose.base.clock import SlotTimes
from e3pose.camera.schedule import KEPT_SLOTS, Schedule, slot_of_frame, take_order
from e3pose.wire.messages import Order

ORIGIN, INTERVAL = 1_000_000_000_000, 40_000_000
TIMES = SlotTimes(ORIGIN, INTERVAL)


def order(slot: int, active: bool = True, session: int = 1, origin: int = ORIGIN) -> Order:
    return Order("cam1", slot, active, "power-saving", origin, INTERVAL, 0, session)


def test_camera_without_orders_does_not_look() -> None:
    assert not Schedule().is_active(0) and Schedule().next_active_ns(0) is None


def test_order_holds_for_its_slot_alone() -> None:
    schedule = take_order(Schedule(), order(5), TIMES.middle_ns(3))
    assert [slot for slot in range(10) if schedule.is_active(slot)] == [5]
    assert not take_order(schedule, order(5, active=False), TIMES.middle_ns(4)).is_active(5)


def test_late_order_is_counted_and_ignored() -> None:
    in_time = take_order(Schedule(), order(5), TIMES.begin_ns(5))
    late = take_order(Schedule(), order(5), TIMES.begin_ns(5) + 1)
    assert in_time.is_active(5) and in_time.late == 0
    assert not late.is_active(5) and (late.late, late.orders) == (1, 1)


def test_newer_edge_forgets_the_orders_of_the_older() -> None:
    schedule = take_order(Schedule(), order(5), TIMES.middle_ns(1))
    newer = take_order(schedule, order(6, session=2), TIMES.middle_ns(1))
    assert not newer.is_active(5) and newer.is_active(6)
    assert take_order(newer, order(7, session=1), TIMES.middle_ns(1)) is newer


def test_orders_of_the_past_are_dropped() -> None:
    schedule = Schedule()
    for slot in range(1000):
        schedule = take_order(schedule, order(slot), TIMES.middle_ns(slot) - INTERVAL)
    assert len(schedule.active) <= KEPT_SLOTS + 3


def test_order_for_the_far_future_is_not_kept() -> None:
    assert not take_order(Schedule(), order(10**9), ORIGIN).active


def test_next_active_slot_says_when_to_wake() -> None:
    schedule = take_order(Schedule(), order(9), TIMES.middle_ns(1))
    assert schedule.next_active_ns(TIMES.middle_ns(1)) == TIMES.begin_ns(9)
    assert schedule.next_active_ns(TIMES.middle_ns(9)) == TIMES.middle_ns(9)
    assert schedule.next_active_ns(TIMES.middle_ns(10)) is None


def slots_of(frame_times_ns: list[int], frame_interval_ns: int) -> list[int]:
    """Return the slots that frames at these times stand for."""
    found, newest = [], -1
    for at_ns in frame_times_ns:
        slot = slot_of_frame(TIMES, at_ns, newest, frame_interval_ns)
        if slot is not None:
            found.append(slot)
            newest = slot
    return found


@pytest.mark.parametrize("phase", np.linspace(-0.5, 0.5, 11).tolist())
@pytest.mark.parametrize("seed", range(3))
def test_every_slot_has_one_frame_whatever_the_phase(phase: float, seed: int) -> None:
    jitter = np.random.default_rng(seed).uniform(-3e6, 3e6, 200)
    times = [ORIGIN + round((i + phase) * INTERVAL + jitter[i]) for i in range(200)]
    found = slots_of(times, INTERVAL)
    assert len(found) == len(set(found)) and found == sorted(found)
    assert set(found) >= set(range(5, 198))  # the first few settle it


@pytest.mark.parametrize("fps", [50.0, 60.0, 90.0, 120.0])
def test_faster_source_gives_a_frame_near_the_middle(fps: float) -> None:
    frame_ns = round(1e9 / fps)
    times = [ORIGIN + i * frame_ns for i in range(200)]
    newest, chosen = -1, {}
    for at_ns in times:
        slot = slot_of_frame(TIMES, at_ns, newest, frame_ns)
        if slot is not None:
            newest, chosen[slot] = slot, at_ns
    inner = range(1, max(chosen))
    for slot in inner:
        nearest = min(abs(at - TIMES.middle_ns(slot)) for at in times)
        assert abs(chosen[slot] - TIMES.middle_ns(slot)) <= nearest + 0.2 * INTERVAL + 2


def test_slower_source_leaves_slots_out() -> None:
    times = [ORIGIN + i * 100_000_000 for i in range(40)]
    found = slots_of(times, 100_000_000)
    assert found == [TIMES.slot_at(at) for at in times]


def test_slots_of_a_wrong_clock_do_not_hold_up_those_of_the_right_one() -> None:
    times = SlotTimes(0, 40_000_000)
    assert slot_of_frame(times, 0, 750, 40_000_000) == 0  # it was half a minute ahead before
    assert slot_of_frame(times, 0, 0, 40_000_000) is None
