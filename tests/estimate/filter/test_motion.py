"""Bodies that nobody looks at, and how much more or less than expected they move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from tests.cases import each_case
from tests.estimate.filter.room import MODEL, run, see, standing, step, turn
from tests.estimate.filter.test_tree import random_prior
from tests.reference.filter_motion import spread

from e3pose.base.arrays import Floats
from e3pose.estimate.filter import Belief
from e3pose.estimate.filter.compare import FURTHEST, LASTS_S
from e3pose.estimate.filter.estimator import steer
from e3pose.estimate.filter.motion import ACCELERATION_LASTS_S, alone, places
from e3pose.estimate.filter.tree import Tree, grow
from e3pose.model.skeleton import COCO17, SKELETONS, Skeleton

TREE = grow(COCO17)
HIP, KNEE, ANKLE = (COCO17.index(f"left_{part}") for part in ("hip", "knee", "ankle"))


def everybody(tree: Tree, covariance: Floats, gains: Floats) -> Floats:
    """Return the covariance of all joints together, of marginals and gains of one track."""
    joints = len(tree.parents)
    whole = np.zeros((joints, joints, 6, 6))
    done: list[int] = []
    for joint in np.concatenate(tree.levels).tolist():
        parent = int(tree.parents[joint])
        for other in done:
            whole[joint, other] = gains[0, joint] @ whole[parent, other]
            whole[other, joint] = whole[joint, other].T
        whole[joint, joint] = covariance[0, joint]
        done.append(joint)
    return np.asarray(whole.transpose(0, 2, 1, 3).reshape(6 * joints, 6 * joints))


def at_once(tree: Tree, dt: float) -> tuple[Floats, Floats]:
    """Return the transition of all joints together and its noise (Van Loan's integral)."""
    joints = len(tree.parents)
    size = 6 * joints
    beside = np.eye(joints)
    beside[np.flatnonzero(tree.parents >= 0), tree.parents[tree.parents >= 0]] = -1
    to_beside, to_world = (np.kron(m, np.eye(6)) for m in (beside, np.linalg.inv(beside)))
    rate, noise = np.zeros((joints, 6, joints, 6)), np.zeros((joints, 6, joints, 6))
    for joint in range(joints):
        rate[joint, :3, joint, 3:] = np.eye(3)
        rate[joint, 3:, joint, 3:] = -np.eye(3) / tree.lasts_s[joint]
        noise[joint, 3:, joint, 3:] = np.eye(3) * tree.drift_m2ps4[joint] * ACCELERATION_LASTS_S
    A = to_world @ rate.reshape(size, size) @ to_beside
    Q = to_world @ noise.reshape(size, size) @ to_world.T
    both = expm(np.block([[-A, Q], [np.zeros_like(A), A.T]]) * dt)
    transition = both[size:, size:].T
    return transition, transition @ both[:size, size:]


# Faces and whole hands are trees like these: with 133 joints the matrix of all takes ten seconds.
SMALL = [skeleton for skeleton in SKELETONS.values() if len(skeleton) <= 33]


@each_case("skeleton", SMALL, ids=lambda s: s.name)
@each_case(("dt", "share"), [(0.04, 1.0), (0.5, 1.0), (0.04, 0.5)])
def test_tree_moves_as_all_joints_in_one_matrix(
    skeleton: Skeleton, dt: float, share: float
) -> None:
    rng = np.random.default_rng(len(skeleton))
    tree = grow(skeleton)
    joints = len(skeleton)
    covariance, shared, made_of = random_prior(tree, rng)
    state = rng.normal(size=(1, joints, 6))
    moved = places(tree, state, dt)
    after, with_parent = spread(tree, covariance, shared, np.full((1, joints), share), dt)
    halved = replace(tree, drift_m2ps4=share * tree.drift_m2ps4)
    transition, noise = at_once(halved, dt)
    whole = transition @ everybody(tree, covariance, made_of.gains) @ transition.T + noise
    blocks = whole.reshape(joints, 6, joints, 6)
    np.testing.assert_allclose(moved.ravel(), transition @ state.ravel(), atol=1e-9)
    for joint, parent in enumerate(tree.parents.tolist()):
        np.testing.assert_allclose(after[0, joint], blocks[joint, :, joint], atol=1e-9)
        if parent >= 0:
            np.testing.assert_allclose(with_parent[0, joint], blocks[joint, :, parent], atol=1e-9)


def test_nothing_moves_in_no_time() -> None:
    covariance, shared, _ = random_prior(TREE, np.random.default_rng(1))
    state = np.random.default_rng(2).normal(size=(1, 17, 6))
    found = (places(TREE, state, 0.0), *spread(TREE, covariance, shared, np.ones((1, 17)), 0.0))
    for before, after in zip((state, covariance, shared), found, strict=True):
        np.testing.assert_allclose(after, before, atol=1e-12)


def walker(speed_mps: float) -> Floats:
    """Return somebody on the way along x, whose left foot is ahead of the knee."""
    state = np.zeros((1, 17, 6))
    state[..., 3] = speed_mps
    state[0, ANKLE, 0] = 0.2
    return state


def test_foot_that_nobody_sees_goes_with_the_body() -> None:
    state = walker(1.2)
    state[0, ANKLE, 3] += 3.0
    moved = places(TREE, state, 1.0)
    assert moved[0, ANKLE, 3] == pytest.approx(moved[0, HIP, 3], abs=0.03)
    assert moved[0, ANKLE, 0] - moved[0, HIP, 0] < 0.2 + 3.0 * TREE.lasts_s[ANKLE]
    assert moved[0, HIP, 3] > 0.2  # the body itself goes on


def test_a_joint_alone_is_about_as_uncertain_as_with_its_body() -> None:
    drift, lasts_s = alone(TREE)
    zero = np.zeros((1, 17, 6, 6))
    known = zero + 1e-12 * np.eye(6)
    for dt in (0.05, 0.2, 0.5):
        expected = spread(TREE, known, zero, np.ones((1, 17)), dt)[0][0, :, 0, 0]
        gone = 1 - np.exp(-dt / lasts_s)
        found = drift * lasts_s**2 * (dt - 2 * lasts_s * gone + lasts_s * gone * (2 - gone) / 2)
        np.testing.assert_allclose(np.sqrt(found / expected), 1.0, atol=0.1)


FPS, SLOTS, LIMBS = 25.0, 150, slice(5, 17)


def swaying(slot: int, reach_m: float) -> Floats:
    """Return a person whose limbs jerk to and fro, a little out of step with the cameras."""
    body = standing((0, 0))
    body[:, LIMBS, 0] += reach_m * np.sign(np.sin(2 * np.pi * slot / 16.0))
    return body


def followed(reach_m: float, noise_px: float, cameras: object = turn) -> Belief:
    """Return what is believed after some seconds with one camera in each slot."""
    rng = np.random.default_rng(3)
    slots = [see(swaying(slot, 0.0), noise_px=noise_px, rng=rng) for slot in range(10)]
    slots += [
        see(swaying(slot, reach_m), cameras(slot), noise_px, rng)  # type: ignore[operator]
        for slot in range(SLOTS)
    ]
    belief, _ = run(slots, fps=FPS)
    assert len(belief) == 1
    return belief


def test_noise_shrinks_for_who_stands_still_and_grows_for_who_jerks() -> None:
    still, jerking = (followed(reach_m, 3.0).agility[0, LIMBS].mean() for reach_m in (0.0, 0.12))
    assert -FURTHEST <= still < -0.3
    assert 0.3 < jerking <= FURTHEST


def test_a_camera_that_only_confirms_itself_teaches_nothing() -> None:
    assert np.abs(followed(0.0, 3.0, lambda slot: (0,)).agility).max() < 0.1


def test_all_cameras_at_once_teach_nothing_and_what_was_learned_fades() -> None:
    belief = followed(0.0, 3.0)
    later, _ = run([see(standing((0, 0)))], fps=FPS, belief=belief)
    again, _ = run([see(standing((0, 0)))] * 10, fps=FPS, belief=later)
    left = np.exp(-10 / FPS / LASTS_S)
    np.testing.assert_allclose(again.agility, left * later.agility, atol=1e-12)


def test_a_correction_is_what_the_newest_look_moved() -> None:
    belief = followed(0.0, 3.0)
    alone, _ = step(MODEL, belief, {}, belief.time_s + 1 / FPS)
    np.testing.assert_array_equal(alone.corrected_m, belief.corrected_m)
    off, _ = step(MODEL, belief, see(standing((0.1, 0.0))), belief.time_s + 1 / FPS)
    assert off.corrected_m[0, :, 0].mean() == pytest.approx(0.1, abs=0.06)


@pytest.mark.parametrize("learned", [-1.0, 0.7])
def test_what_a_predictor_leaves_open_counts_times_the_agility(learned: float) -> None:
    belief = followed(0.0, 3.0)
    taught = replace(belief, agility=np.full_like(belief.agility, learned))
    rows, foreseen_m = np.array([0]), belief.state[..., :3]
    steered = steer(MODEL.tree, taught, rows, foreseen_m, 0.08, 0.5)
    np.testing.assert_allclose(steered.drift_share, 0.5 * np.exp(learned))
