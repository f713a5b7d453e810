"""Make other bodies and other motion of recorded ones, so that neither is learned by heart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.predict.normalise import LEFT_RIGHT, NUM_COMMON

MIRRORED = (1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 12, 13)  # common joints, left and right swapped
# What each common joint hangs on; -1 is the middle of the hips. Parents come first in ORDER.
PARENT = (-1, -1, 0, 1, 2, 3, 12, 12, 6, 7, 8, 9, -1, 12)
ORDER = (0, 1, 12, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 13)
# hips, thighs, shanks, spine, shoulders, upper arms, forearms, head. Lengths of limbs differ by 3
# to 4 % between adults of one height; where conventions put hips, shoulders and head, by more.
LIMB = (0, 0, 1, 1, 2, 2, 4, 4, 5, 5, 6, 6, 3, 7)
LOG_LIMB = np.array([0.075, 0.035, 0.035, 0.04, 0.06, 0.035, 0.035, 0.075])
LOG_SIDE = 0.01  # by which left and right differ
LOG_HEIGHT = 0.06
SHAPE_M = 0.004  # by which each joint of a window is moved for good: no two conventions agree
ARMS = ((6, (8, 10)), (7, (9, 11)))  # shoulder, and what hangs on it


def other_bodies(joints_m: Floats, rng: np.random.Generator) -> Floats:
    """Return motion `(num_slots, size, NUM_COMMON, 3)` of people of other heights and limbs."""
    size = joints_m.shape[1]
    limbs = np.exp(rng.normal(0, LOG_LIMB, (size, len(LOG_LIMB))))[:, list(LIMB)]
    limbs *= np.exp(rng.normal(0, LOG_SIDE, limbs.shape))
    height = np.exp(rng.normal(0, LOG_HEIGHT, (size, 1, 1)))  # larger people take larger steps
    joints_m = joints_m * height
    root = joints_m[:, :, :2].mean(axis=2)
    changed = np.empty_like(joints_m)
    for joint in ORDER:
        parent = PARENT[joint]
        old, new = (root, root) if parent < 0 else (joints_m[:, :, parent], changed[:, :, parent])
        changed[:, :, joint] = new + (joints_m[:, :, joint] - old) * limbs[:, joint, None]
    changed += rng.normal(0, SHAPE_M, (size, NUM_COMMON, 3))
    return np.asarray(changed)


def mirrored(joints_m: Floats, which: NDArray[np.bool_]) -> None:
    """Mirror the windows `which` of `(num_slots, size, NUM_COMMON, 3)` in place."""
    flipped = joints_m[:, which][:, :, MIRRORED]
    flipped[..., 0] *= -1
    joints_m[:, which] = flipped


def swapped_arms(joints_m: Floats, share: float, rng: np.random.Generator) -> Floats:
    """Return motion in which a share of the windows has the arms of another window.

    Args:
        joints_m: `(num_slots, size, NUM_COMMON, 3)` metres.
        share: of the windows.
        rng: random numbers.
    """
    size = joints_m.shape[1]
    taker = np.flatnonzero(rng.random(size) < share)
    giver = rng.integers(0, size, len(taker))
    turn = _heading(joints_m[:, taker]) - _heading(joints_m[:, giver])
    cosine, sine = np.cos(turn), np.sin(turn)
    swapped: Floats = joints_m.copy()
    for shoulder, arm in ARMS:
        for joint in arm:
            x, y, z = np.moveaxis(joints_m[:, giver, joint] - joints_m[:, giver, shoulder], -1, 0)
            turned = np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=-1)
            swapped[:, taker, joint] = joints_m[:, taker, shoulder] + turned
    return swapped


def uneven_time(span: int, size: int, most: float, rng: np.random.Generator) -> Floats:
    """Return `(size, span)` slots from 0 to `span - 1` that pass now faster, now slower.

    The pace of a window changes by up to `most` of itself, as a sine of up to one period.
    """
    depth = rng.uniform(0, most, (size, 1))
    phase = rng.uniform(0, 2 * np.pi, (size, 1))
    rate = 2 * np.pi * rng.uniform(0.3, 1.0, (size, 1)) / (span - 1)
    slot = np.arange(span, dtype=np.float64)
    time = slot - depth / rate * (np.cos(rate * slot + phase) - np.cos(phase))
    return np.asarray(np.clip(time * (span - 1) / time[:, -1:], 0, span - 1))


def _heading(joints_m: Floats) -> Floats:
    """Return `(num_slots, size)` angles of the line from the right to the left of people."""
    across = sum(
        (joints_m[:, :, left, :2] - joints_m[:, :, right, :2] for left, right in LEFT_RIGHT),
        start=np.zeros((*joints_m.shape[:2], 2)),
    )
    return np.asarray(np.arctan2(across[..., 1], across[..., 0]))
