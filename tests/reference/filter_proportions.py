"""The lengths of limbs by proportions of people: the plain form of `filter/proportions.py`."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.estimate.filter.bones import Proportions
from e3pose.estimate.filter.outliers import MEASURED_SIGMAS, OUTLIER_SIGMAS
from e3pose.estimate.filter.proportions import PASSES, ROUNDING, SHORTEST_M, SWEEPS
from e3pose.model.proportions import (
    LEAST_M,
    MOST_M,
    NOISE_M,
    SLIDE_M,
    STATURE_M,
    STATURE_SPREAD,
    UNLIKE,
)


def expect(bones_m: Floats, counts: Floats, body: Proportions) -> tuple[Floats, Floats, float]:
    """Return lengths and variances `(num_bones,)` of one person, and the variance of the size."""
    shares, spreads = body.shares, body.spreads
    there = np.isin(np.arange(len(shares)), body.kinds)
    member = body.kinds[:, None] == np.arange(len(shares))  # (num_bones, num_kinds)
    length = np.maximum(bones_m, SHORTEST_M)
    error = (SLIDE_M**2 + NOISE_M**2 / np.maximum(counts, 1e-9)) / length**2
    weight = np.where(counts > 0, 1 / (UNLIKE**2 + error), 0.0)[:, None] * member
    w = weight.sum(axis=0)
    y = (weight * (np.log(length)[:, None] - shares)).sum(axis=0) / np.where(w > 0, w, 1.0)
    seen, doubt = w > 0, np.ones(len(shares))
    total = spreads**2 + 1 / np.where(seen, w, 1.0)
    prior = 1 / STATURE_SPREAD**2
    for _ in range(PASSES):
        each = np.where(seen, doubt / total, 0.0)
        known = prior + each.sum()
        stature = (prior * np.log(STATURE_M) + (each * y).sum()) / known
        stature = np.clip(stature, np.log(LEAST_M), np.log(MOST_M))
        doubt = np.where(seen, 1 / (1 + (y - stature) ** 2 / total / OUTLIER_SIGMAS**2), 1.0)
    part = 1 / (1 + doubt * w * spreads**2)
    alone = part * spreads**2
    logs = shares + part * stature + (1 - part) * y
    of_kind = part**2 / known + alone
    limb = body.kinds >= 0
    lengths_m = np.where(limb, np.exp(logs[body.kinds]), 0.0)
    variances = np.where(limb, of_kind[body.kinds] + UNLIKE**2, 0.0)
    if not there.any():
        return lengths_m, variances, STATURE_SPREAD**2
    size = part[there].mean() ** 2 / known + alone[there].sum() / there.sum() ** 2
    return lengths_m, variances, float(size)


def keep(
    lengths_m: Floats, body: Proportions, joints_m: Floats, covariance_m2: Floats, measured: Flags
) -> tuple[Floats, Floats, Flags]:
    """Return joints, covariances and what was measured of one person; see `keep_lengths`."""
    joints_m, before = joints_m.copy(), joints_m
    sigma_m = np.sqrt(np.trace(covariance_m2, axis1=-2, axis2=-1) / 3)
    for _ in range(SWEEPS):
        pulled = [  # a list, for every bone is looked at
            _pull(joints_m, pair, lengths_m[bone], body.gives[bone], sigma_m * ~_held(body, bone))
            for bone, pair in enumerate(body.bones.tolist())
        ]
        if not any(pulled):
            break
    moved = np.nan_to_num(joints_m - before)  # a missing toe, too, takes along the next one
    for joint in body.order[1:]:
        parent, bone = body.parents[joint], body.links[joint]
        if body.limbs[joint] and (bone < 0 or body.gives[bone] == 0):
            joints_m[joint] += moved[parent]
            moved[joint] += moved[parent]
        elif body.limbs[joint]:
            held = np.full(len(joints_m), 0.0)
            held[joint] = 1.0
            _pull(joints_m, [joint, parent], lengths_m[bone], body.gives[bone], held)
            moved[joint] = np.nan_to_num(joints_m[joint] - before[joint])
    wider_m2 = covariance_m2 + moved[:, :, None] * moved[:, None, :]
    far = np.linalg.norm(moved, axis=-1) > MEASURED_SIGMAS * sigma_m
    return joints_m, wider_m2, measured & ~far


def _held(body: Proportions, bone: int) -> Flags:
    """Return `(num_joints,)`: the trunk's end of an arm or a leg."""
    held = np.zeros(len(body.parents), dtype=bool)
    held[body.bones[bone, 0]] = body.anchored[bone]
    return held


def stature_m(joints_m: Floats, body: Proportions) -> float:
    """Return the stature that limbs have in the median; 0 without any."""
    limb = body.kinds >= 0
    first, second = body.bones[limb].T
    length = np.linalg.norm(joints_m[first] - joints_m[second], axis=-1)
    known = length > SHORTEST_M
    logs = np.log(length[known]) - body.shares[body.kinds[limb][known]]
    return float(np.exp(np.median(logs))) if len(logs) else 0.0


def _pull(joints_m: Floats, ends: list[int], length_m: float, give: float, sigma_m: Floats) -> bool:
    """Bring two joints within the length, the less certain one more; return whether they moved."""
    first, second = ends
    between = joints_m[second] - joints_m[first]
    apart_m = np.linalg.norm(between)
    low_m, high_m = length_m / give if give else 0.0, length_m * give if give else np.inf
    if not (apart_m > high_m * ROUNDING or apart_m < low_m / ROUNDING):
        return False
    excess = apart_m - np.clip(apart_m, low_m, high_m)
    along = between / apart_m
    share = sigma_m[first] ** 2 / (sigma_m[first] ** 2 + sigma_m[second] ** 2)
    joints_m[first] += share * excess * along
    joints_m[second] -= (1 - share) * excess * along
    return True
