"""Which frame of a video shows which slot."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from tests.cases import each_case

from e3pose.camera.orientation import Orientation
from e3pose.camera.slots import SlotGrid, frames_in_slots
from e3pose.camera.source import Frame


def frames(times_s: Sequence[float]) -> list[Frame]:
    return [Frame(i, t, None, Orientation()) for i, t in enumerate(times_s)]


def chosen(times_s: Sequence[float], grid: SlotGrid, offset_s: float = 0.0) -> dict[int, int]:
    return {slot: f.index for slot, _, f in frames_in_slots(frames(times_s), grid, offset_s)}


def test_every_frame_of_a_regular_video_is_a_slot() -> None:
    assert chosen([i / 60 for i in range(5)], SlotGrid(60)) == {i: i for i in range(5)}


def test_nearest_of_several_frames_is_taken() -> None:
    assert chosen([0.0, 0.04, 0.09, 0.11, 0.2], SlotGrid(10)) == {0: 0, 1: 2, 2: 4}


def test_earlier_of_two_equally_near_frames_is_taken() -> None:
    assert chosen([0.0, 0.075, 0.125, 0.2], SlotGrid(10)) == {0: 0, 1: 1, 2: 3}


def test_slot_without_a_frame_within_half_a_slot_is_left_out() -> None:
    assert chosen([0.0, 0.1, 0.3, 0.36], SlotGrid(10)) == {0: 0, 1: 1, 3: 2, 4: 3}


def test_slow_video_leaves_every_second_slot_out() -> None:
    assert chosen([0.0, 0.1, 0.2], SlotGrid(20)) == {0: 0, 2: 1, 4: 2}


@each_case(("offset_s", "first"), [(0.2, 2), (-0.2, 0), (0.24, 2), (0.26, 3)])
def test_offset_moves_a_video_on_the_common_clock(offset_s: float, first: int) -> None:
    slots = chosen([i / 10 for i in range(6)], SlotGrid(10), offset_s)
    assert min(slots) == first
    assert slots[first] == (2 if offset_s < 0 else 0)


def test_start_and_max_slots_cut_the_ends_off() -> None:
    grid = SlotGrid(10, start_s=0.3, max_slots=2)
    assert chosen([i / 10 for i in range(9)], grid) == {0: 3, 1: 4}


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
