"""Proportions of people in the filter: strangers, children, who sits, who has lost a leg, a dog."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.room import ALL, BODY, MODEL, RIG, Views, run, see, standing
from tests.interpreted import interpreted
from tests.reference import filter_proportions

from e3pose.base.arrays import Floats
from e3pose.estimate.filter.bones import Proportions, proportions_of
from e3pose.estimate.filter.proportions import expect_lengths, kept, stature_of
from e3pose.estimate.filter.tree import grow
from e3pose.model.camera import Camera
from e3pose.model.people import People
from e3pose.model.pose import Poses2D
from e3pose.model.proportions import KINDS, RIGID, STATURE_M, STATURE_SPREAD
from e3pose.model.skeleton import BODY_JOINTS, COCO17, SKELETONS

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


BONES = proportions_of(COCO17, grow(COCO17))
NUM_BONES = len(BONES.bones)
LIMB = BONES.kinds >= 0


def expect(
    bones_m: Floats, counts: Floats, body: Proportions = BONES
) -> tuple[Floats, Floats, float]:
    lengths_m, variances = np.empty(len(body.bones)), np.empty(len(body.bones))
    room = np.empty((4, len(KINDS)))
    size = interpreted(expect_lengths)(bones_m, counts, body, room, lengths_m, variances)
    return lengths_m, variances, size


def usual_m(stature_m: float) -> Floats:
    """Return the lengths of bones of somebody with usual proportions, 0 for bones without."""
    return np.where(LIMB, stature_m * np.exp(BONES.shares[BONES.kinds]), 0.0)


def bone(first: str, second: str) -> int:
    ends = {COCO17.index(first), COCO17.index(second)}
    return next(row for row, pair in enumerate(BONES.bones.tolist()) if set(pair) == ends)


@each_case("name", sorted(n for n, one in SKELETONS.items() if set(one.joints) >= BODY_JOINTS))
@each_case("seed", range(4))
def test_lengths_and_kept_joints_are_as_in_numpy(name: str, seed: int) -> None:
    skeleton, rng = SKELETONS[name], np.random.default_rng(seed)
    body = proportions_of(skeleton, grow(skeleton))
    assert (body.kinds >= 0).sum() == 12
    bones_m = rng.uniform(0, 0.8, (1, len(body.bones)))
    counts = rng.integers(0, 4, bones_m.shape) * rng.uniform(1, 60, bones_m.shape)
    lengths_m, variances, size = filter_proportions.expect(bones_m[0], counts[0], body)
    found = expect(bones_m[0], counts[0], body)
    np.testing.assert_allclose(found[0], lengths_m, rtol=1e-9)
    np.testing.assert_allclose(found[1], variances, rtol=1e-9)
    assert found[2] == pytest.approx(size, rel=1e-9)
    joints_m = rng.normal(scale=0.4, size=(1, len(skeleton), 3))
    joints_m[0, rng.random(len(skeleton)) < 0.1] = np.nan
    covariance_m2 = rng.uniform(1e-4, 0.1, (1, len(skeleton), 1, 1)) * np.eye(3)
    measured = rng.random((1, len(skeleton))) < 0.7
    moved = kept(body, bones_m, counts, joints_m, covariance_m2, measured)
    wanted = filter_proportions.keep(lengths_m, body, joints_m[0], covariance_m2[0], measured[0])
    np.testing.assert_allclose(moved[0][0], wanted[0], atol=1e-9)
    np.testing.assert_allclose(moved[1][0], wanted[1], atol=1e-9)
    np.testing.assert_array_equal(moved[2][0], wanted[2])
    for joint in np.flatnonzero(body.limbs):
        row, parent = body.links[joint], body.parents[joint]
        if row >= 0 and body.gives[row] == RIGID:
            apart_m = np.linalg.norm(moved[0][0, joint] - moved[0][0, parent])
            assert np.isnan(apart_m) or 1 / 1.0701 < apart_m / lengths_m[row] < 1.0701


def test_of_a_stranger_usual_lengths_are_expected() -> None:
    nothing = np.zeros(NUM_BONES)
    lengths_m, variances, size = expect(nothing, nothing)
    np.testing.assert_allclose(lengths_m, usual_m(STATURE_M))
    assert np.sqrt(variances[LIMB].min()) == pytest.approx(np.hypot(0.12, 0.055), rel=0.1)
    assert np.sqrt(size) == pytest.approx(STATURE_SPREAD, rel=0.05)


@each_case("stature_m", [1.3, 1.5, 1.9])
def test_a_few_limbs_tell_the_others_and_the_size(stature_m: float) -> None:
    counts = np.zeros(NUM_BONES)
    counts[[bone("left_hip", "left_knee"), bone("left_shoulder", "left_hip")]] = 50
    lengths_m, _, size = expect(usual_m(stature_m), counts)
    forearm = bone("right_elbow", "right_wrist")
    assert abs(np.log(lengths_m[forearm] / usual_m(stature_m)[forearm])) < 0.08
    assert np.sqrt(size) < 0.05
    counts[LIMB] = 50
    lengths_m, _, size = expect(usual_m(stature_m), counts)
    np.testing.assert_allclose(lengths_m[LIMB], usual_m(stature_m)[LIMB], rtol=0.02)
    assert np.sqrt(size) < 0.02


def test_left_and_right_are_expected_alike() -> None:
    learned_m, counts = usual_m(1.7), np.where(LIMB, 20.0, 0.0)
    left, right = bone("left_elbow", "left_wrist"), bone("right_elbow", "right_wrist")
    learned_m[left] *= 1.3
    lengths_m, _, _ = expect(learned_m, counts)
    assert lengths_m[left] == lengths_m[right]


def test_limbs_that_nobody_has_are_not_believed() -> None:
    learned_m, counts = usual_m(1.7), np.where(LIMB, 50.0, 0.0)
    forearms = [bone(f"{s}_elbow", f"{s}_wrist") for s in ("left", "right")]
    shanks = [bone(f"{s}_knee", f"{s}_ankle") for s in ("left", "right")]
    learned_m[forearms], learned_m[shanks] = 0.11, 1.65
    lengths_m, _, _ = expect(learned_m, counts)
    assert 0.2 < lengths_m[forearms[0]] < 0.27
    assert 0.36 < lengths_m[shanks[0]] < 0.5


def test_a_body_that_fits_is_left_alone() -> None:
    joints_m = BODY[None]
    covariance_m2 = np.tile(1e-4 * np.eye(3), (1, len(COCO17), 1, 1))
    first, second = BONES.bones.T
    bones_m = np.linalg.norm(BODY[first] - BODY[second], axis=-1)[None]
    counts, measured = np.full((1, NUM_BONES), 60.0), np.ones((1, len(COCO17)), dtype=bool)
    found = kept(BONES, bones_m, counts, joints_m, covariance_m2, measured)
    np.testing.assert_array_equal(found[0], joints_m)
    np.testing.assert_array_equal(found[1], covariance_m2)
    assert found[2].all()
    stature_m = interpreted(stature_of)(BODY, BONES, np.empty(NUM_BONES))
    assert stature_m == pytest.approx(1.75, abs=0.15)


def test_an_ankle_across_the_room_comes_back_unmeasured_and_vague() -> None:
    joints_m, ankle, knee = BODY[None].copy(), COCO17.index("left_ankle"), COCO17.index("left_knee")
    joints_m[0, ankle] += [1.5, 0, 0]
    covariance_m2 = np.tile(1e-4 * np.eye(3), (1, len(COCO17), 1, 1))
    covariance_m2[0, ankle] = 0.19**2 * np.eye(3)
    nothing, measured = np.zeros((1, NUM_BONES)), np.ones((1, len(COCO17)), dtype=bool)
    found_m, wider_m2, still = kept(BONES, nothing, nothing, joints_m, covariance_m2, measured)
    assert np.linalg.norm(found_m[0, ankle] - found_m[0, knee]) < 0.5
    np.testing.assert_allclose(found_m[0, knee], joints_m[0, knee], atol=0.05)
    moved_m = np.linalg.norm(found_m[0, ankle] - joints_m[0, ankle])
    assert np.trace(wider_m2[0, ankle]) >= moved_m**2 > 1
    assert not still[0, ankle] and still[0, knee]
