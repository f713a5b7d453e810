"""Cameras that seldom answer are tried farther and farther apart, one after the other."""

from __future__ import annotations

import numpy as np

from e3pose.edge.lead import FAR_S, Lead, lead_for
from e3pose.edge.trials import EVERY_S, LONGEST_PAUSE, TURN_S, Trials

INTERVAL_S = 0.1
UNRELIABLE = np.array([False, False, True, True])
NOBODY = np.zeros(4, dtype=bool)


def tried(answers: float, seconds: float) -> np.ndarray:
    """Return `(num_slots, num_cameras)`: who is ordered while so many trials are answered."""
    trials, dice, found = Trials(4, INTERVAL_S), np.random.default_rng(1), []
    for slot in range(round(seconds / INTERVAL_S)):
        if (camera := trials.whose(UNRELIABLE, slot)) is not None:
            trials.plan(slot + 3, camera)
        found.append(trials.take(slot))
        trials.observe(slot, found[-1], found[-1] & (dice.uniform(size=4) < answers))
    return np.array(found)


def test_cameras_that_answer_are_tried_each_ten_seconds() -> None:
    found = tried(answers=1.0, seconds=200.0)
    np.testing.assert_allclose(found.mean(axis=0), [0, 0, *[TURN_S / EVERY_S] * 2], atol=0.01)
    assert (found.sum(axis=1) <= 1).all()  # one after the other


def test_pauses_of_cameras_that_do_not_answer_double() -> None:
    found = tried(answers=0.05, seconds=1000.0)
    begins = np.flatnonzero(np.diff(found[:, 2].astype(int)) > 0) * INTERVAL_S
    turns = np.round(begins / EVERY_S)
    assert np.diff(turns).max() == LONGEST_PAUSE and found[:, 2].mean() < 0.04
    assert (np.diff(turns) <= np.maximum(2 * turns[:-1], 1)).all()
    assert len(turns) >= 1000 / EVERY_S / LONGEST_PAUSE


def test_planned_order_belongs_to_its_slot_alone() -> None:
    trials = Trials(4, INTERVAL_S)
    trials.plan(7, 2)
    trials.plan(9, 3)
    assert not trials.take(6).any()
    assert trials.take(7).tolist() == [False, False, True, False]
    assert not trials.take(7).any()
    assert not trials.take(10).any() and not trials.take(9).any()  # 9 was skipped
    assert trials.whose(NOBODY, 0) is None


def test_orders_for_a_slow_camera_leave_earlier() -> None:
    lead = Lead(2, longest_s=(0.05, 0.06, 0.4, 3.0))
    assert [lead_for(lead, camera, INTERVAL_S) for camera in range(4)] == [2, 2, 5, 7]
    limit_s = 0.06 + FAR_S
    assert np.ceil(limit_s / INTERVAL_S + 0.6) == 7  # no camera is tried later than followed
    assert lead_for(lead, 0, INTERVAL_S, wake_s=1.0) == 12
    assert lead_for(Lead(4), 0, INTERVAL_S) == 4  # before any report
