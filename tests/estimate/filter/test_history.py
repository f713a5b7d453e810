"""The history of people: where each was shown in the slots before, whoever comes and goes."""

from __future__ import annotations

import numpy as np
from tests.cases import each_case
from tests.estimate.filter.room import MODEL, see, standing, step, turn

from e3pose.estimate.base import Estimate
from e3pose.estimate.filter.estimator import Filtered

SLOTS = 6


def shown(visits: list[tuple[int, int]]) -> list[Estimate]:
    """Show people walking side by side, each from one slot until another."""
    filtered, everybody = Filtered(MODEL, step, SLOTS), []
    memory = filtered.begin()
    for slot in range(90):
        there = [
            (-1.5 + 0.03 * slot, 1.2 * row - 1.2)
            for row, (begin, end) in enumerate(visits)
            if begin <= slot < end
        ]
        cameras = {*turn(slot), *turn(slot + 1), *turn(slot + 2)}
        memory, estimate = filtered.estimate(
            memory, see(standing(*there), cameras), slot / 25, lambda: 0.0
        )
        everybody.append(estimate)
    return everybody


@each_case(
    "visits",
    [
        [(0, 90)],
        [(0, 90), (30, 90)],  # somebody comes
        [(0, 35), (0, 90)],  # somebody leaves, whose row the other takes
        [(0, 90), (25, 60), (40, 90)],
    ],
)
def test_history_is_where_each_person_was_shown(visits: list[tuple[int, int]]) -> None:
    past: list[dict[int, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]] = []
    changes = 0
    for estimate in shown(visits):
        people, history = estimate.people, estimate.history
        ids = people.track_ids.tolist()
        changes += bool(past) and set(past[-1]) != set(ids)
        past.append(dict(zip(ids, people.joints_m, strict=True)))
        assert history.track_ids.tolist() == ids
        assert history.joints_m.shape == (SLOTS, len(ids), 17, 3)
        for person, track_id in enumerate(ids):
            for age, history_m in enumerate(history.joints_m[::-1, person]):
                before = past[-1 - age] if age < len(past) else {}
                expected_m = before.get(track_id, np.full((17, 3), np.nan))
                np.testing.assert_array_equal(history_m, expected_m)
    assert changes >= len(visits)
