"""Other bodies and other motion: what may change, and what never does."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.predict.normalise import NUM_COMMON
from e3pose_lab.train.bodies import (
    MIRRORED,
    ORDER,
    PARENT,
    mirrored,
    other_bodies,
    swapped_arms,
    uneven_time,
)


def motion(size: int = 200, num_slots: int = 6, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    pose = rng.normal(size=(1, size, NUM_COMMON, 3)) * 0.3
    return pose + np.cumsum(rng.normal(0, 0.02, (num_slots, size, NUM_COMMON, 3)), axis=0)


def test_mirroring_twice_is_nothing() -> None:
    assert [MIRRORED[i] for i in MIRRORED] == list(range(NUM_COMMON))
    once = motion()
    which = np.arange(200) % 2 == 0
    mirrored(once, which)
    np.testing.assert_array_equal(once[:, ~which], motion()[:, ~which])
    np.testing.assert_allclose(once[:, which, 2, 0], -motion()[:, which, 3, 0])
    mirrored(once, which)
    np.testing.assert_array_equal(once, motion())


def test_every_joint_hangs_on_one_that_comes_before_it() -> None:
    assert sorted(ORDER) == list(range(NUM_COMMON))
    for place, joint in enumerate(ORDER):
        assert PARENT[joint] in (-1, *ORDER[:place])


def test_limbs_change_alike_on_both_sides_and_in_all_slots() -> None:
    before = motion()
    after = other_bodies(before, np.random.default_rng(1))
    for left, right in ((2, 3), (8, 9)):  # knees on hips, elbows on shoulders
        ratios = []
        for joint in (left, right):
            parent = PARENT[joint]
            old = np.linalg.norm(before[:, :, joint] - before[:, :, parent], axis=-1)
            new = np.linalg.norm(after[:, :, joint] - after[:, :, parent], axis=-1)
            ratios.append(new / old)
        long = np.linalg.norm(before[:, :, left] - before[:, :, PARENT[left]], axis=-1) > 0.3
        assert np.std(np.log(np.array(ratios)[:, long])) < 0.12
        np.testing.assert_allclose(ratios[0][0][long[0]], ratios[0][-1][long[0]], rtol=0.1)


def test_swapped_arms_keep_shoulders_and_lengths() -> None:
    before = motion()
    after = swapped_arms(before, 1.0, np.random.default_rng(2))
    others = [joint for joint in range(NUM_COMMON) if joint not in (8, 9, 10, 11)]
    np.testing.assert_array_equal(after[:, :, others], before[:, :, others])
    lengths = np.linalg.norm(before[:, :, 8] - before[:, :, 6], axis=-1)
    swapped = np.linalg.norm(after[:, :, 8] - after[:, :, 6], axis=-1)
    apart = np.abs(swapped[:, :, None] - lengths[:, None]).max(axis=0).min(axis=1)
    np.testing.assert_allclose(apart, 0, atol=1e-9)  # whole arms, over time, of somebody
    assert (np.abs(swapped - lengths).max(axis=0) > 1e-3).mean() > 0.9  # and of somebody else
    np.testing.assert_array_equal(swapped_arms(before, 0.0, np.random.default_rng(2)), before)


def test_time_passes_unevenly_but_forwards_and_to_the_end() -> None:
    slots = uneven_time(25, 500, 0.3, np.random.default_rng(3))
    np.testing.assert_allclose(slots[:, [0, -1]], [[0, 24]] * 500, atol=1e-9)
    steps = np.diff(slots, axis=1)
    assert steps.min() > 0.4 and steps.max() < 1.8 and steps.std() > 0.03
    even = uneven_time(25, 3, 0.0, np.random.default_rng(3))
    np.testing.assert_allclose(even, np.arange(25)[None].repeat(3, axis=0), atol=1e-9)
