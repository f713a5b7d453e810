"""Proportions of people in the filter: strangers, children, who sits, who has lost a leg, a dog."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.room import ALL, BODY, MODEL, RIG, Views, run, see, standing

from e3pose.base.arrays import Floats
from e3pose.model.camera import Camera
from e3pose.model.people import People
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17

FPS, SLOTS = 12.5, 40
LEGS = [
    COCO17.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("knee", "ankle")
]


def apart_m(estimate: People, first: str, second: str) -> Floats:
    """Return the distance of two joints of everybody who is shown, `(num_persons,)`."""
    between = estimate.joints_m[:, COCO17.index(first)] - estimate.joints_m[:, COCO17.index(second)]
    return np.asarray(np.linalg.norm(between, axis=-1))


def changed(views: Views, joints: list[int], shift_px: Floats, score: float) -> dict[int, Poses2D]:
    """Return the views with some joints elsewhere, or missing with score 0."""
    found = {}
    for camera, view in views.items():
        keypoints_px, scores = view.keypoints_px.copy(), view.scores.copy()
        keypoints_px[:, joints] += shift_px if score else np.nan
        scores[:, joints] = score
        found[camera] = Poses2D(keypoints_px, scores)
    return found


def guessed(joint: str, score: float = 0.4) -> Iterator[Views]:
    """Yield a person of whom every camera guesses one joint elsewhere, each somewhere else."""
    rng = np.random.default_rng(0)
    for _ in range(SLOTS):
        views: dict[int, Poses2D] = {}
        for camera in ALL:
            one = see(standing((0.3, 0.2)), [camera], 2.0, rng)
            views |= changed(one, [COCO17.index(joint)], rng.normal(0, 120, 2), score)
        yield views


def test_a_guessed_ankle_stays_within_reach_of_the_knee() -> None:
    _, slots = run(guessed("left_ankle"), FPS)
    for estimate in slots[10:]:
        assert len(estimate) == 1
        assert 0.3 < apart_m(estimate, "left_knee", "left_ankle")[0] < 0.55
        assert apart_m(estimate, "right_knee", "right_ankle")[0] == pytest.approx(0.42, abs=0.05)


def test_a_guess_that_all_cameras_share_misleads_legs_alone() -> None:
    elsewhere = BODY.copy()
    elsewhere[COCO17.index("left_ankle")] += [0.9, 0.6, 0.2]
    rng = np.random.default_rng(1)
    _, slots = run((see(elsewhere[None], ALL, 2.0, rng) for _ in range(SLOTS)), FPS)
    last, others = slots[-1], np.setdiff1d(np.arange(len(COCO17)), LEGS)
    for side in ("left", "right"):
        assert apart_m(last, f"{side}_knee", f"{side}_ankle")[0] < 0.6
    np.testing.assert_allclose(last.joints_m[0, others], BODY[others], atol=0.05)


@each_case("size", [0.55, 0.75, 1.15])
def test_children_and_giants_are_as_large_as_they_are(size: float) -> None:
    person, rng = size * BODY[None], np.random.default_rng(2)
    _, slots = run((see(person, ALL, 2.0, rng) for _ in range(SLOTS)), FPS)
    np.testing.assert_allclose(slots[-1].joints_m[0], person[0], atol=0.03)


def test_who_sits_and_hides_the_legs_is_where_the_chest_is() -> None:
    rng = np.random.default_rng(3)
    seated = BODY - [0, 0, 0.4]
    views = (
        changed(see(seated[None], ALL, 2.0, rng), LEGS, np.zeros(2), 0.0) for _ in range(SLOTS)
    )
    _, slots = run(views, FPS)
    estimate = slots[-1]
    assert np.isnan(estimate.joints_m[0, LEGS]).all()
    seen = np.setdiff1d(np.arange(17), LEGS)
    np.testing.assert_allclose(estimate.joints_m[0, seen], seated[seen], atol=0.03)


def test_a_leg_that_ends_at_the_knee_misleads_no_other_limb() -> None:
    """The detector places the missing ankle at the stump."""
    stump = BODY.copy()
    knee, ankle = COCO17.index("left_knee"), COCO17.index("left_ankle")
    stump[ankle] = stump[knee] - [0, 0, 0.12]
    rng = np.random.default_rng(4)
    _, slots = run((see(stump[None], ALL, 2.0, rng) for _ in range(SLOTS)), FPS)
    others = np.setdiff1d(np.arange(17), [knee, ankle])
    estimate = slots[-1]
    np.testing.assert_allclose(estimate.joints_m[0, others], stump[others], atol=0.03)
    np.testing.assert_allclose(estimate.joints_m[0, knee], stump[knee], atol=0.1)


def test_a_dog_that_is_taken_for_a_person_moves_nobody() -> None:
    """Four legs, a trunk that lies: no proportions of a person, and no end of the numbers."""
    dog = BODY[:, [2, 1, 0]] * [0.5, 0.4, 0.4] + [1.5, -1.0, 0.3]
    rng = np.random.default_rng(5)
    people = np.stack([BODY, dog])
    _, slots = run((see(people, ALL, 2.0, rng) for _ in range(SLOTS)), FPS)
    for estimate in slots[10:]:
        assert np.isfinite(estimate.joints_m).all()
        nearest = np.abs(estimate.joints_m[:, 11] - BODY[11]).max(axis=-1).argmin()
        np.testing.assert_allclose(estimate.joints_m[nearest], BODY, atol=0.04)


def test_one_camera_knows_the_distance_of_a_stranger_from_its_first_look() -> None:
    """Two cameras start the person, who then walks to where one camera alone sees."""
    rng = np.random.default_rng(6)
    camera: Camera = RIG.cameras[0]
    start = [see(standing((0.0, 0.0)), (0, 1), 2.0, rng)] * 3
    away = [see(standing((-0.04 * slot, 0.0)), (0,), 2.0, rng) for slot in range(30)]
    belief, _ = run([*start, *away], FPS)
    hip = COCO17.index("left_hip")
    truth_m = BODY[hip] + [-0.04 * 29, 0, 0]
    off = belief.state[0, hip, :3] - truth_m
    centre_m = MODEL.rig.centers_m[0]
    line = (truth_m - centre_m) / np.linalg.norm(truth_m - centre_m)
    sigma_m = np.sqrt(line @ belief.covariance[0, hip, :3, :3] @ line)
    assert camera.camera_id == "cam0"
    assert abs(off @ line) < 3 * sigma_m < 1.5
