"""Slots and orders of a camera: which frame shows which slot, and room for one."""

from __future__ import annotations

import threading
from collections.abc import Sequence

import msgspec
import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.clock import SlotTimes
from e3pose.camera.live import Box
from e3pose.camera.orientation import Orientation
from e3pose.camera.schedule import KEPT_SLOTS, Schedule, slot_of_frame, take_order
from e3pose.camera.slots import SlotGrid, frames_in_slots
from e3pose.camera.source import Frame
from e3pose.wire.messages import Order

S = 10**9
ORIGIN, INTERVAL = 1_000_000_000_000, 40_000_000
TIMES = SlotTimes(ORIGIN, INTERVAL)


def order(slot: int, active: bool = True, session: int = 1, origin: int = ORIGIN) -> Order:
    return Order("cam1", slot, active, "power-saving", origin, INTERVAL, 0, session)


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


def test_orders_of_the_past_and_of_the_far_future_are_dropped() -> None:
    schedule = Schedule()
    assert not schedule.is_active(0) and schedule.next_active_ns(0) is None
    for slot in range(1000):
        schedule = take_order(schedule, order(slot), TIMES.middle_ns(slot) - INTERVAL)
    assert len(schedule.active) <= KEPT_SLOTS + 3
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


@each_case("phase", np.linspace(-0.5, 0.5, 11).tolist())
@each_case("seed", range(3))
def test_every_slot_has_one_frame_whatever_the_phase(phase: float, seed: int) -> None:
    jitter = np.random.default_rng(seed).uniform(-3e6, 3e6, 200)
    times = [ORIGIN + round((i + phase) * INTERVAL + jitter[i]) for i in range(200)]
    found = slots_of(times, INTERVAL)
    assert len(found) == len(set(found)) and found == sorted(found)
    assert set(found) >= set(range(5, 198))  # the first few settle it


@each_case("fps", [50.0, 60.0, 90.0, 120.0])
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


def test_sleep_begins_with_its_slot_and_ends_in_time_for_the_next_order() -> None:
    order = Order(
        "cam0", 20, False, "power-saving", 0, S // 10, 1, 1, lead=3, asleep_until=100, wake_s=2.0
    )
    schedule = take_order(Schedule(), order, 18 * S // 10)
    times = schedule.times
    assert times is not None
    alarm_ns = times.begin_ns(97) - 2 * S
    assert schedule.alarm_ns(times.begin_ns(20) - 1, 0.5) is None  # orders before it count
    assert schedule.alarm_ns(times.begin_ns(20), 0.5) == alarm_ns
    assert schedule.alarm_ns(alarm_ns - S // 10, 0.5) is None  # not worth it any more
    assert schedule.alarm_ns(alarm_ns - S // 10, 0.5, asleep=True) == alarm_ns
    assert schedule.alarm_ns(alarm_ns, 0.5, asleep=True) is None
    unlearned = take_order(Schedule(), msgspec.structs.replace(order, wake_s=0.0), 18 * S // 10)
    assert unlearned.alarm_ns(times.begin_ns(20), 0.5) == times.begin_ns(97) - S // 2


def test_later_order_lengthens_shortens_or_ends_a_sleep_and_an_older_one_does_not() -> None:
    def order(slot: int, until: int, sent: int) -> Order:
        return Order("cam0", slot, False, "power-saving", 0, S // 10, sent, 1, asleep_until=until)

    schedule = take_order(Schedule(), order(20, 100, 5), S)
    schedule = take_order(schedule, order(21, 100, 6), S)
    assert (schedule.asleep_from, schedule.asleep_until) == (20, 100)
    schedule = take_order(schedule, order(19, 0, 4), S)  # overtaken on its way
    assert schedule.asleep_until == 100
    schedule = take_order(schedule, order(22, 80, 7), S)
    assert (schedule.asleep_from, schedule.asleep_until) == (22, 80)
    late = take_order(schedule, order(23, 0, 8), 60 * S)  # late for its slot, and still true
    assert late.asleep_until == 0 and late.late == 1


def test_camera_whose_clock_stood_still_does_not_trust_its_alarm() -> None:
    sent_ns = 4 * S
    order = Order("cam0", 50, False, "power-saving", 0, S // 10, sent_ns, 1, asleep_until=100)
    schedule = take_order(Schedule(), order, 5 * S)
    assert schedule.alarm_ns(5 * S, 0.5) is not None
    later = msgspec.structs.replace(order, sent_edge_ns=8 * S)
    assert take_order(schedule, later, 5 * S).alarm_ns(5 * S, 0.5) is None


def frames(times_s: Sequence[float]) -> list[Frame]:
    return [Frame(i, t, None, Orientation()) for i, t in enumerate(times_s)]


def chosen(times_s: Sequence[float], grid: SlotGrid, offset_s: float = 0.0) -> dict[int, int]:
    return {slot: f.index for slot, _, f in frames_in_slots(frames(times_s), grid, offset_s)}


@each_case(
    ("times_s", "grid", "expected"),
    [
        ([i / 60 for i in range(5)], SlotGrid(60), {i: i for i in range(5)}),
        ([0.0, 0.04, 0.09, 0.11, 0.2], SlotGrid(10), {0: 0, 1: 2, 2: 4}),  # the nearest
        ([0.0, 0.075, 0.125, 0.2], SlotGrid(10), {0: 0, 1: 1, 2: 3}),  # of equals the earlier
        ([0.0, 0.1, 0.3, 0.36], SlotGrid(10), {0: 0, 1: 1, 3: 2, 4: 3}),  # within half a slot
        ([0.0, 0.1, 0.2], SlotGrid(20), {0: 0, 2: 1, 4: 2}),
        ([i / 10 for i in range(9)], SlotGrid(10, start_s=0.3, max_slots=2), {0: 3, 1: 4}),
    ],
)
def test_a_slot_shows_the_frame_nearest_to_it(
    times_s: list[float], grid: SlotGrid, expected: dict[int, int]
) -> None:
    assert chosen(times_s, grid) == expected


@each_case(("offset_s", "first"), [(0.2, 2), (-0.2, 0), (0.24, 2), (0.26, 3)])
def test_offset_moves_a_video_on_the_common_clock(offset_s: float, first: int) -> None:
    slots = chosen([i / 10 for i in range(6)], SlotGrid(10), offset_s)
    assert min(slots) == first
    assert slots[first] == (2 if offset_s < 0 else 0)


def test_times_are_of_the_frame_not_of_the_slot() -> None:
    grid = SlotGrid(10, start_s=0.1)
    times = [t for _, t, _ in frames_in_slots(frames([0.12, 0.19]), grid, 0.0)]
    assert times == pytest.approx([0.02, 0.09])


def test_reading_from_any_slot_on_chooses_the_same_frames() -> None:
    times = [0.0, 0.03, 0.08, 0.12, 0.2, 0.24, 0.26, 0.31, 0.4, 0.49]
    grid, offset_s = SlotGrid(10, start_s=0.05), 0.02
    whole = chosen(times, grid, offset_s)
    for first in whole:
        begin = grid.video_time_s(first, offset_s)
        late = [f for f in frames(times) if f.time_s >= begin - 1e-9]
        part = {s: f.index for s, _, f in frames_in_slots(late, grid, offset_s, first)}
        assert part == {slot: index for slot, index in whole.items() if slot >= first}


def test_newest_wins_and_the_rest_is_counted() -> None:
    box: Box[int] = Box()
    for thing in (1, 2, 3):
        box.put(thing)
    assert box.take() == 3 and box.dropped == 2


def test_taker_waits_and_is_let_go() -> None:
    box: Box[int] = Box()
    found: list[int | None] = []
    thread = threading.Thread(target=lambda: found.append(box.take()))
    thread.start()
    box.close()
    thread.join(5)
    assert found == [None] and box.take() is None
