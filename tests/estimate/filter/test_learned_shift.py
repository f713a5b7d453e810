"""Constant shifts of cameras, learned while the filter runs, against shifts that are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from tests.estimate.filter.room import MODEL, NUM_CAMERAS, Views, run, see, step
from tests.estimate.filter.test_learned_noise import FPS, stated, walking
from tests.reference.belief_arrays import belief_from_arrays, belief_to_arrays

from e3pose.base.arrays import Floats
from e3pose.estimate.filter import Belief
from e3pose.estimate.filter.learned_shift import COUNT, MOST, found_px, shifts_px
from e3pose.estimate.filter.outliers import MEMORY
from e3pose.model.pose import Poses2D

SHIFT_PX = np.array([6.0, -4.0])
QUIET = np.ones(NUM_CAMERAS)


def shifted(slots: Sequence[Views], camera: int, shift_px: Floats = SHIFT_PX) -> list[Views]:
    """Return the views with all keypoints of one camera moved."""
    return [
        {
            index: Poses2D(view.keypoints_px + shift_px * (index == camera), view.scores)
            for index, view in slot.items()
        }
        for slot in slots
    ]


def relative(found_px: Floats, camera: int) -> tuple[Floats, Floats]:
    """Return what was found of one camera and of the others, beside the mean of those.

    A shift of all cameras that moves people in the world is the same as people elsewhere.
    """
    others = np.delete(found_px, camera, axis=0)
    return found_px[camera] - others.mean(axis=0), others - others.mean(axis=0)


def test_a_shift_is_found_within_a_quarter_and_the_others_are_left_alone() -> None:
    belief, _ = run(shifted(walking(40.0, QUIET), 2), fps=FPS)
    found, others = relative(shifts_px(belief.shifts, MODEL), 2)
    assert np.linalg.norm(found - SHIFT_PX) < np.linalg.norm(SHIFT_PX) / 4
    assert (np.linalg.norm(others, axis=1) < 1.2).all()


def test_it_is_found_with_one_camera_a_slot() -> None:
    slots = walking(2.0, QUIET) + walking(80.0, QUIET, "turn")[25:]
    belief, _ = run(shifted(slots, 2), fps=FPS)
    found, others = relative(shifts_px(belief.shifts, MODEL), 2)
    assert found @ SHIFT_PX / (SHIFT_PX @ SHIFT_PX) > 0.6
    assert (np.linalg.norm(others, axis=1) < 2.0).all()


def test_people_are_nearer_to_where_they_are_once_a_shift_is_known() -> None:
    slots = walking(40.0, QUIET)
    stiff = np.tile([0.0, 0.0, 1e9], (NUM_CAMERAS, 1))  # as if no shift had been seen for days

    def off_m(views: list[Views], belief: Belief) -> float:
        moved = run(views, fps=FPS, belief=belief)[1][-50:]
        apart = [
            np.linalg.norm(m.joints_m[:, None] - r.joints_m, axis=-1).mean(axis=-1).min(axis=1)
            for m, r in zip(moved, right, strict=True)
        ]
        assert all(len(each) == 3 for each in apart)
        return float(np.mean(apart))

    empty = Belief.empty(MODEL)
    right = run(slots, fps=FPS)[1][-50:]
    views = shifted(slots, 2)
    assert off_m(views, empty) < 0.75 * off_m(views, replace(empty, shifts=stiff))


def test_nothing_is_found_where_nothing_is_off() -> None:
    belief, _ = run(walking(20.0, QUIET), fps=FPS)
    assert (shifts_px(belief.shifts, MODEL) == 0).all()


def test_what_all_cameras_agree_about_leaves_nothing_to_learn() -> None:
    """People who are all a hand's breadth aside are there for all cameras."""
    aside_m = np.array([0.1, 0.0, 0.0])
    _, estimates = run(walking(8.0, np.zeros(NUM_CAMERAS)), fps=FPS)
    people = [each.joints_m + aside_m for each in estimates if len(each) == 3]
    belief, _ = run([see(joints_m) for joints_m in people], fps=FPS)
    assert (shifts_px(belief.shifts, MODEL) == 0).all()


def test_one_wild_person_in_one_view_shifts_no_camera() -> None:
    slots = walking(20.0, QUIET)
    wild = []
    for slot in slots:
        view = slot[1]
        pixels = view.keypoints_px.copy()
        pixels[0] += 15.0  # somebody whom this detector always puts too far right
        wild.append({**slot, 1: Poses2D(pixels, view.scores)})
    belief, _ = run(wild, fps=FPS)
    assert np.linalg.norm(shifts_px(belief.shifts, MODEL)[1]) < 15.0 * np.sqrt(2) / 3


def test_bounds_hold_whatever_is_seen() -> None:
    drifting = [
        shifted([slot], 3, np.array([min(1.0 * index, 80.0), 0.0]))[0]
        for index, slot in enumerate(walking(24.0, QUIET))
    ]
    belief, _ = run(drifting, fps=FPS)
    assert np.linalg.norm(belief.shifts[:, :COUNT], axis=1).max() <= MOST * 1032 + 1e-9
    assert (belief.shifts[:, COUNT] <= MEMORY).all()


def test_nothing_is_reported_before_much_is_seen() -> None:
    belief = Belief.empty(MODEL)
    assert (shifts_px(belief.shifts, MODEL) == 0).all()
    assert np.isnan(found_px(belief.shifts, MODEL)).all()
    belief, _ = run(walking(8.0, QUIET), fps=FPS)
    assert np.isfinite(found_px(belief.shifts, MODEL)).all()


def test_it_outlasts_people_and_pauses() -> None:
    belief, _ = run(shifted(walking(8.0, QUIET), 2), fps=FPS, model=stated(1.0))
    later, _ = step(stated(1.0), belief, {}, belief.time_s + 60)
    assert len(later) == 0
    np.testing.assert_array_equal(later.shifts, belief.shifts)
    again = belief_from_arrays(belief_to_arrays(later), MODEL)
    np.testing.assert_array_equal(again.shifts, belief.shifts)


def test_ghosts_of_one_camera_teach_nothing() -> None:
    belief, _ = run(walking(4.0, QUIET), fps=FPS)
    alone = [{0: slot[0]} for slot in walking(8.0, QUIET)[50:]]
    late, _ = run(alone[:13], fps=FPS, belief=belief)
    after, _ = run(alone[13:], fps=FPS, belief=late)
    np.testing.assert_array_equal(after.shifts, late.shifts)


def test_a_body_that_is_off_in_one_view_for_seconds_shifts_no_camera() -> None:
    wild = []
    for slot in walking(2.0, QUIET):
        view = slot[1]
        pixels = view.keypoints_px.copy()
        pixels[0] += 15.0
        wild.append({**slot, 1: Poses2D(pixels, view.scores)})
    belief, _ = run(wild, fps=FPS)
    assert np.linalg.norm(shifts_px(belief.shifts, MODEL)[1]) < 15.0 * np.sqrt(2) / 9
