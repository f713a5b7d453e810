"""Which tracks are one person."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from e3pose.evaluate.smoothed import keep_people
from e3pose.model.people import People
from e3pose.model.slot_record import SlotRecord

# Track, first and last slot, place, joints: somebody who is lost twice, another, and two ghosts.
TRACKS = (
    (3, 0, 9, 0.0, 4), (5, 0, 29, 5.0, 4), (7, 14, 29, 0.5, 4), (8, 12, 13, 40.0, 4),
    (9, 3, 5, 2.0, 1),
)  # fmt: skip


def records() -> list[SlotRecord]:
    found = []
    for slot in range(30):
        there = [track for track in TRACKS if track[1] <= slot <= track[2]]
        joints_m = np.full((len(there), 4, 3), np.nan)
        for row, (_, _, _, x, joints) in enumerate(there):
            joints_m[row, :joints] = (x, 0.0, 1.0)
        people = People(np.array([track[0] for track in there], dtype=np.int64), joints_m)
        none, empty = np.zeros(0, dtype=bool), np.zeros(0)
        found.append(SlotRecord(slot, slot / 10, none, none, people, empty, empty, none))
    return found


@pytest.mark.parametrize(
    ("count", "names", "left"),
    [
        (1, {5: 1}, 4),
        (2, {5: 1, 7: 2, 3: 2}, 2),
        (3, {5: 1, 7: 2, 3: 2, 8: 3}, 1),
        (9, {5: 1, 7: 2, 3: 2, 8: 3, 9: 4}, 0),
    ],
)
def test_tracks_that_follow_each_other_are_one_person(
    count: int, names: dict[int, int], left: int
) -> None:
    before = records()
    before.append(replace(before[0], slot=30, people=before[0].people[:0]))  # nobody stays nobody
    after, dropped = keep_people(before, count)
    assert dropped == left
    for one, other in zip(before, after, strict=True):
        kept = [i for i in one.people.track_ids.tolist() if i in names]
        assert other.people.track_ids.tolist() == [names[i] for i in kept]
        assert len(other.people.joints_m) == len(kept)
