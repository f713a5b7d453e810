"""What the network sees of a person: gaps closed, place and heading taken out."""

from __future__ import annotations

import numpy as np
import pytest
from tests.interpreted import interpreted
from tests.reference.normalise import to_world

from e3pose.base.arrays import Floats
from e3pose.model.skeleton import BODY25, BODY_JOINTS, COCO17, SHELF14, SKELETONS
from e3pose.predict.kernels.history import SPEED_FLOOR_M
from e3pose.predict.normalise import COMMON_JOINTS, NUM_COMMON, common_columns
from e3pose_lab.prediction import normalise as histories
from e3pose_lab.prediction.normalise import to_person

# tests/lab/train has them compiled.
fill_gaps = interpreted(histories.fill_gaps)
normalise = interpreted(histories.normalise)
to_common = interpreted(histories.to_common)


def walk(num_slots: int = 10, num_tracks: int = 2, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    pose = rng.normal(size=(num_tracks, NUM_COMMON, 3))
    return pose + np.cumsum(rng.normal(0, 0.02, (num_slots, num_tracks, NUM_COMMON, 3)), axis=0)


def test_a_gap_is_closed_as_the_person_moved() -> None:
    slot = np.arange(6)[:, None, None, None]
    truth = np.zeros((1, 1, 4, 1)) + np.arange(4)[:, None] + slot * [0.1, -0.2, 0.0]
    spoilt = truth.copy()
    spoilt[0:2, 0, 0] = np.nan  # not yet seen
    spoilt[2:4, 0, 1] = np.nan  # between two sights
    spoilt[4:, 0, 2] = np.nan  # lost
    filled, measured = fill_gaps(spoilt)
    np.testing.assert_allclose(filled, truth, atol=1e-12)
    np.testing.assert_array_equal(measured, np.isfinite(spoilt).all(axis=-1))


def test_somebody_gone_for_a_while_returns_evenly() -> None:
    history = np.zeros((5, 1, 2, 3))
    history[:, 0, :, 0] = np.arange(5)[:, None]
    history[1:4] = np.nan
    filled = fill_gaps(history)[0]
    np.testing.assert_allclose(filled[:, 0, 0, 0], np.arange(5), atol=1e-12)


def test_a_joint_never_seen_is_zero_and_not_measured() -> None:
    history = walk()
    history[:, 0, 5] = np.nan
    filled, measured = fill_gaps(history)
    assert (filled[:, 0, 5] == 0).all() and not measured[:, 0, 5].any()
    assert np.isfinite(filled).all()


def test_the_way_to_a_person_and_back_is_the_identity() -> None:
    history = walk()
    normal = normalise(history, 0.04, 10)
    back = to_world(normal, to_person(normal, history))
    np.testing.assert_allclose(back, history, atol=1e-12)


def test_features_do_not_depend_on_place_and_heading() -> None:
    history = walk()
    angle = -2.4
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    here, there = normalise(history, 0.04, 10), normalise(history @ turn.T + [9, -4, 1], 0.04, 10)
    np.testing.assert_allclose(here.features, there.features, atol=1e-5)
    np.testing.assert_allclose(here.context, there.context, atol=1e-5)


def test_features_of_motion_do_not_depend_on_speed() -> None:
    pose = walk(1)[0]
    motion = np.random.default_rng(1).normal(size=(10, 2, NUM_COMMON, 3)) * 0.02
    slow = normalise(pose + 0.1 * (motion - motion[-1]), 0.04, 10)
    fast = normalise(pose + (motion - motion[-1]), 0.04, 10)
    columns = slice(3 * NUM_COMMON, 6 * NUM_COMMON)
    np.testing.assert_allclose(slow.features[..., columns], fast.features[..., columns], atol=0.1)
    np.testing.assert_allclose(fast.speed_m / slow.speed_m, 10, rtol=0.05)


def test_a_short_history_is_missing_before_it_began() -> None:
    history = walk(3)
    short = normalise(history, 0.04, 10)
    padded = normalise(
        np.concatenate([np.full((7, *history.shape[1:]), np.nan), history]), 0.04, 10
    )
    np.testing.assert_array_equal(short.features, padded.features)
    measured = short.features[..., 6 * NUM_COMMON :]
    assert (measured[:7] == 0).all() and (measured[7:] == 1).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300, -1e5])
def test_nothing_that_is_no_place_reaches_the_network(value: float) -> None:
    history = walk()
    history[:, 0] = value
    history[4, 1, 3] = value
    normal = normalise(history, 0.04, 10)
    assert np.isfinite(normal.features).all() and np.isfinite(normal.context).all()
    assert not normal.seen[0].any() and normal.seen[1].all()
    assert normal.speed_m[0] == pytest.approx(SPEED_FLOOR_M)


def test_neck_and_head_stand_for_what_a_skeleton_has() -> None:
    for skeleton, neck, head in (
        (COCO17, ("left_shoulder", "right_shoulder"), ("nose",)),
        (BODY25, ("neck",), ("nose",)),
        (SHELF14, ("bottom_head",), ("top_head",)),
    ):
        columns = common_columns(skeleton)
        names = [tuple(skeleton.joints[c] for c in chosen if c >= 0) for chosen in columns]
        assert names[12:] == [neck, head]
        assert names[:12] == [(joint,) for joint in COMMON_JOINTS[:12]]


@pytest.mark.parametrize("name", [n for n, s in SKELETONS.items() if {*s.joints} >= BODY_JOINTS])
def test_a_mean_of_joints_needs_them_all(name: str) -> None:
    skeleton = SKELETONS[name]
    joints = np.random.default_rng(0).normal(size=(2, len(skeleton), 3))
    joints[1, skeleton.index("left_shoulder")] = np.nan
    common = to_common(joints, common_columns(skeleton))
    assert np.isfinite(common[0]).all()
    assert np.isnan(common[1, 6]).all()
    assert np.isnan(common[1, 12]).all() == (not {"neck", "bottom_head"} & {*skeleton.joints})
