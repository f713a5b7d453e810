"""The motion that predictors are measured on, and its disturbance."""

from __future__ import annotations

import numpy as np
import pytest

from e3pose.base.arrays import Floats
from e3pose.model.camera import Camera, Rig
from e3pose.model.people import People
from e3pose.model.skeleton import BODY25, CMU31, COCO17, PANOPTIC19, SHELF14, Skeleton
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording, Truth, ViewSeries
from e3pose_lab.prediction.motion import (
    BODY_JOINTS,
    Motion,
    body_errors,
    body_joints,
    disturbed,
    estimated_motion,
    true_motion,
)


def _rig() -> Rig:
    K = np.array([[900.0, 0, 500], [0, 900, 400], [0, 0, 1]])
    return Rig((Camera.from_world_to_camera("c", (1000, 800), K, np.eye(3), [0.0, 0.0, 5.0]),))


def _recording(truth: Truth) -> Recording:
    nothing = ViewSeries.from_views([], [], [], 17)
    num_slots = len(truth.joints_m)
    return Recording("test", _rig(), 30.0, num_slots, COCO17, (nothing,), truth=truth)


def _motion(*people: Floats) -> Motion:
    return Motion("test", "truth", COCO17, _rig(), 1 / 30, people)


@pytest.mark.parametrize(
    ("skeleton", "neck", "head"),
    [
        (COCO17, ("left_shoulder", "right_shoulder"), "nose"),
        (BODY25, ("neck",), "nose"),
        (PANOPTIC19, ("neck",), "nose"),
        (CMU31, ("neck",), "top_head"),
        (SHELF14, ("bottom_head",), "top_head"),
    ],
)
def test_fourteen_joints_of_any_skeleton(
    skeleton: Skeleton, neck: tuple[str, ...], head: str
) -> None:
    pose = np.random.default_rng(0).normal(size=(2, len(skeleton), 3))
    body = body_joints(pose, skeleton)
    assert body.shape == (2, 14, 3)
    expected = pose[:, [skeleton.index(name) for name in neck]].mean(axis=1)
    np.testing.assert_allclose(body[:, BODY_JOINTS.index("neck")], expected)
    np.testing.assert_array_equal(body[:, -1], pose[:, skeleton.index(head)])
    knee = body[:, BODY_JOINTS.index("right_knee")]
    np.testing.assert_array_equal(knee, pose[:, skeleton.index("right_knee")])


def test_mean_joints_carry_no_stated_error() -> None:
    errors = body_errors(np.arange(17.0)[None], COCO17)[0]
    assert np.isnan(errors[BODY_JOINTS.index("neck")])
    assert errors[BODY_JOINTS.index("right_knee")] == COCO17.index("right_knee")


def test_people_of_the_truth_last_from_their_first_slot_to_their_last() -> None:
    joints = np.full((20, 3, 17, 3), np.nan)
    joints[5:12, 0] = 1.0
    joints[7, 0] = np.nan  # away for a moment
    joints[3:20, 2, 4] = 2.0  # one joint is enough
    truth = Truth(COCO17, ("a", "b", "c"), joints)
    motion = true_motion(_recording(truth), truth)
    assert [len(person) for person in motion.people] == [7, 17]
    assert np.isnan(motion.people[0][2]).all()
    assert motion.interval_s == pytest.approx(1 / 30)


def test_tracks_of_a_replay_are_people() -> None:
    truth = Truth(COCO17, (), np.zeros((6, 0, 17, 3)))
    flags = np.ones(1, dtype=bool)

    def record(slot: int, ids: list[int]) -> SlotRecord:
        joints = np.full((len(ids), 17, 3), float(slot))
        people = People(np.array(ids, dtype=np.int64), joints)
        return SlotRecord(slot, slot / 30, flags, flags, people, np.zeros(1), np.zeros(1), flags)

    seen = [record(0, [4]), record(1, [4, 7]), record(2, [7]), record(3, [7, 4])]
    motion = estimated_motion(_recording(truth), seen)
    assert motion.source == "estimates"
    first, second = motion.people
    np.testing.assert_array_equal(first[:, 0, 0], [0, 1, np.nan, 3])
    np.testing.assert_array_equal(second[:, 0, 0], [1, 2, 3])


def test_noise_has_the_stated_size_and_memory_and_joints_go_missing() -> None:
    still = np.zeros((6000, 17, 3))
    (noisy,) = disturbed(_motion(still), noise_m=0.02, missing=0.2, seed=1)
    assert np.isnan(noisy).any(axis=-1).mean() == pytest.approx(0.2, abs=0.01)
    assert np.nanstd(noisy) == pytest.approx(0.02, rel=0.05)
    # 0.45 (exp(-k/3) + exp(-k/75)) of the variance remains after k frames of 1/30 s.
    for slots in (1, 10):
        product = np.nanmean(noisy[slots:] * noisy[:-slots]) / 0.02**2
        expected = 0.45 * (np.exp(-slots / 3) + np.exp(-slots / 75))
        assert product == pytest.approx(expected, abs=0.06)


def test_noise_is_the_same_for_a_seed_and_differs_between_people_and_recordings() -> None:
    still = np.zeros((20, 17, 3))
    motion = _motion(still, still)
    first, second = disturbed(motion, 0.02, 0.2, seed=1)
    again, _ = disturbed(motion, 0.02, 0.2, seed=1)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, second, equal_nan=True)
    other, _ = disturbed(motion, 0.02, 0.2, seed=2)
    assert not np.array_equal(first, other, equal_nan=True)
    elsewhere = Motion("other", "truth", COCO17, _rig(), 1 / 30, (still,))
    assert not np.array_equal(first, disturbed(elsewhere, 0.02, 0.2, 1)[0], equal_nan=True)


def test_nothing_is_disturbed_without_noise_and_loss() -> None:
    pose = np.random.default_rng(0).normal(size=(20, 17, 3))
    pose[3, 4] = np.nan
    np.testing.assert_array_equal(disturbed(_motion(pose), 0.0, 0.0, 0)[0], pose)
