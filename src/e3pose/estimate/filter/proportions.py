"""Limb lengths: prior over people, and the lengths learned of one person."""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.bones import Proportions
from e3pose.estimate.filter.outliers import MEASURED_SIGMAS, ROBUST
from e3pose.model.proportions import (
    LEAST_M,
    MOST_M,
    NOISE_M,
    SLIDE_M,
    STATURE_M,
    STATURE_SPREAD,
    UNLIKE,
)

# tuned: slots, slots | not recorded | learned bones
BONE_TEACHERS, BONE_MEMORY = 5, 100  # slots before a length is trusted, and that it averages over
PASSES = 3  # numerics
SHORTEST_M = 1e-3  # numerics
SWEEPS = 4  # numerics
ROUNDING = 1.0 + 1e-9  # numerics


def kept(
    body: Proportions,
    bones_m: Floats,
    counts: Floats,
    joints_m: Floats,
    covariance_m2: Floats,
    measured: Flags,
) -> tuple[Floats, Floats, Flags]:
    """Return people with limbs of possible lengths; nothing is changed in place.

    Args:
        body: the bones.
        bones_m: `(num_persons, num_bones)` lengths learned.
        counts: `(num_persons, num_bones)` slots that taught them.
        joints_m: `(num_persons, num_joints, 3)` NaN where missing.
        covariance_m2: `(num_persons, num_joints, 3, 3)` of them.
        measured: `(num_persons, num_joints)`.

    Returns:
        Joints; covariances, wider where a joint was moved; what was measured and not contradicted.
    """
    joints_m, covariance_m2 = np.array(joints_m, order="C"), np.array(covariance_m2, order="C")
    measured = np.array(measured, order="C")
    lengths = np.ascontiguousarray(bones_m), np.ascontiguousarray(counts)
    keep_all(body, *lengths, joints_m, covariance_m2, measured)
    return joints_m, covariance_m2, measured


def expected_m(body: Proportions, bones_m: Floats, counts: Floats) -> Floats:
    """Return the lengths `(num_bones,)` of a person's limbs; 0 where nothing is known of people.

    Args:
        body: the bones.
        bones_m: `(num_bones,)` lengths learned.
        counts: `(num_bones,)` slots that taught them.
    """
    lengths_m, variances = np.empty(len(body.bones)), np.empty(len(body.bones))
    room = np.empty((4, len(body.shares)))
    expect_lengths(bones_m, counts, body, room, lengths_m, variances)
    return lengths_m


def median_lengths_m(body: Proportions, joints_m: Floats, telling: Flags) -> tuple[Floats, Floats]:
    """Return the median lengths of a person's bones and how many slots tell them, `(num_bones,)`.

    Args:
        body: the bones.
        joints_m: `(num_slots, num_joints, 3)`.
        telling: `(num_slots, num_joints)` where a joint is known well.
    """
    first, second = body.bones.T
    both = telling[:, first] & telling[:, second]
    apart_m = np.linalg.norm(joints_m[:, first] - joints_m[:, second], axis=-1)
    counts = both.sum(axis=0)
    ranked = np.sort(np.where(both, apart_m, np.inf), axis=0)
    middle = ranked[np.maximum(counts - 1, 0) // 2, np.arange(len(first))]
    return np.where(counts > 0, middle, 0.0), counts.astype(np.float64)


@kernel
def expect_lengths(
    bones_m: Floats,
    counts: Floats,
    body: Proportions,
    room: Floats,
    lengths_m: Floats,
    variances: Floats,
) -> float:
    """Fill the lengths that a person's limbs have; return the variance of the person's log size.

    With w the information of what was learned about a kind of limb, y its mean, s the logarithm of
    the stature and a = 1 / (1 + w spread^2):

        s ~ N(prior) and y - log share ~ N(s, spread^2 + 1/w),  log length = share + a s + (1 - a) y

    exact where all is normal. A kind that does not fit the others is a mistake of the detector
    rather than odd proportions, and counts less.

    Args:
        bones_m: `(num_bones,)` learned.
        counts: `(num_bones,)` slots that taught them.
        body: the bones.
        room: scratch, `(4, num_kinds)`.
        lengths_m: `(num_bones,)` filled; 0 where the kind is -1.
        variances: `(num_bones,)` filled, of their logarithms.
    """
    kinds, shares, spreads = body.kinds, body.shares, body.spreads
    means, weights, doubts, there = room[0], room[1], room[2], room[3]
    for kind in range(len(shares)):
        means[kind] = weights[kind] = there[kind] = 0.0
        doubts[kind] = 1.0
    for bone in range(len(kinds)):
        kind = kinds[bone]
        if kind < 0:
            continue
        there[kind] = 1.0
        if counts[bone] > 0.0:
            length_m = max(bones_m[bone], SHORTEST_M)
            error = (SLIDE_M**2 + NOISE_M**2 / counts[bone]) / length_m**2
            weight = 1.0 / (UNLIKE**2 + error)
            means[kind] += weight * (math.log(length_m) - shares[kind])
            weights[kind] += weight
    for kind in range(len(shares)):
        if weights[kind] > 0.0:
            means[kind] /= weights[kind]
    stature, known = math.log(STATURE_M), 1.0 / STATURE_SPREAD**2
    for _ in range(PASSES):
        total, known = math.log(STATURE_M) / STATURE_SPREAD**2, 1.0 / STATURE_SPREAD**2
        for kind in range(len(shares)):
            if weights[kind] > 0.0:
                weight = doubts[kind] / (spreads[kind] ** 2 + 1.0 / weights[kind])
                total += weight * means[kind]
                known += weight
        stature = min(max(total / known, math.log(LEAST_M)), math.log(MOST_M))
        for kind in range(len(shares)):
            if weights[kind] > 0.0:
                off = (means[kind] - stature) ** 2 / (spreads[kind] ** 2 + 1.0 / weights[kind])
                doubts[kind] = 1.0 / (1.0 + off * ROBUST)
    shared, own, num_kinds = 0.0, 0.0, 0.0
    for kind in range(len(shares)):
        if there[kind] > 0.0:
            weight = doubts[kind] * weights[kind]
            part = 1.0 / (1.0 + weight * spreads[kind] ** 2)
            alone = part * spreads[kind] ** 2
            means[kind] = shares[kind] + part * stature + (1.0 - part) * means[kind]
            weights[kind] = part * part / known + alone
            shared += part
            own += alone
            num_kinds += 1.0
    for bone in range(len(kinds)):
        kind = kinds[bone]
        lengths_m[bone] = math.exp(means[kind]) if kind >= 0 else 0.0
        variances[bone] = weights[kind] + UNLIKE**2 if kind >= 0 else 0.0
    if num_kinds == 0.0:
        return STATURE_SPREAD**2
    return (shared * shared / known + own) / num_kinds**2


@kernel
def keep_lengths(
    lengths_m: Floats,
    body: Proportions,
    joints_m: Floats,
    covariance_m2: Floats,
    measured: Flags,
) -> None:
    """Move the joints of a person until no limb is longer or shorter than it can be.

    The less certain end of a limb moves more, but no arm or leg moves the trunk. In the end each
    joint beyond shoulder or hip goes by the one before it, and takes feet and hands along. What a
    joint moves by is added to its covariance; one that moves by more than `MEASURED_SIGMAS` was
    not measured.

    Args:
        lengths_m: `(num_bones,)` expected.
        body: the bones.
        joints_m: `(num_joints, 3)` NaN where missing; changed.
        covariance_m2: `(num_joints, 3, 3)` widened.
        measured: `(num_joints,)` cleared where a length contradicts.
    """
    bones, gives = body.bones, body.gives
    moved = np.zeros_like(joints_m)
    for sweep in range(SWEEPS):
        kept = True
        for bone in range(len(bones)):
            first, second = bones[bone, 0], bones[bone, 1]
            excess = _excess_m(joints_m[first], joints_m[second], lengths_m[bone], gives[bone])
            if excess != 0.0:
                kept = False
                near, far = _variance(covariance_m2[first]), _variance(covariance_m2[second])
                share = 0.0 if body.anchored[bone] else near / (near + far)
                _pull(joints_m, moved, first, second, share * excess)
                _pull(joints_m, moved, second, first, (1.0 - share) * excess)
        if kept:
            if sweep == 0:
                return
            break
    for place in range(1, len(body.order)):
        joint = body.order[place]
        parent, bone = body.parents[joint], body.links[joint]
        if body.limbs[joint] == 0:
            continue
        if bone < 0 or gives[bone] == 0.0:  # it goes where its limb went
            for axis in range(3):
                joints_m[joint, axis] += moved[parent, axis]
                moved[joint, axis] += moved[parent, axis]
            continue
        excess = _excess_m(joints_m[parent], joints_m[joint], lengths_m[bone], gives[bone])
        if excess != 0.0:
            _pull(joints_m, moved, joint, parent, excess)
    for joint in range(len(joints_m)):
        squares = moved[joint, 0] ** 2 + moved[joint, 1] ** 2 + moved[joint, 2] ** 2
        if squares > MEASURED_SIGMAS**2 * _variance(covariance_m2[joint]):
            measured[joint] = False
        for a in range(3):
            for b in range(3):
                covariance_m2[joint, a, b] += moved[joint, a] * moved[joint, b]


@kernel
def _excess_m(first: Floats, second: Floats, length_m: float, give: float) -> float:
    """Return by how much a limb is too long, below 0 if too short; 0 where it can be so."""
    if not give > 0.0:
        return 0.0
    squares = 0.0
    for axis in range(3):
        squares += (first[axis] - second[axis]) ** 2
    apart_m = math.sqrt(squares)
    if apart_m > length_m * give * ROUNDING:
        return apart_m - length_m * give
    if apart_m < length_m / give / ROUNDING:
        return apart_m - length_m / give
    return 0.0  # for NaN, too


@kernel
def _pull(joints_m: Floats, moved: Floats, joint: int, other: int, by_m: float) -> None:
    """Move a joint towards another, away from it below 0."""
    squares = 0.0
    for axis in range(3):
        squares += (joints_m[other, axis] - joints_m[joint, axis]) ** 2
    apart_m = math.sqrt(squares)
    for axis in range(3):
        along = (joints_m[other, axis] - joints_m[joint, axis]) / apart_m
        if not apart_m > SHORTEST_M:  # no direction: downwards
            along = 1.0 if axis == 2 else 0.0
        joints_m[joint, axis] += by_m * along
        moved[joint, axis] += by_m * along


@kernel
def _variance(block: Floats) -> float:
    return float((block[0, 0] + block[1, 1] + block[2, 2]) / 3)


@kernel
def keep_all(
    body: Proportions,
    bones_m: Floats,
    counts: Floats,
    joints_m: Floats,
    covariance_m2: Floats,
    measured: Flags,
) -> None:
    """Apply `keep_lengths` to people with their own lengths.

    Args:
        body: the bones.
        bones_m: `(num_persons, num_bones)` learned.
        counts: `(num_persons, num_bones)` slots that taught them.
        joints_m: `(num_persons, num_joints, 3)` NaN where missing; changed.
        covariance_m2: `(num_persons, num_joints, 3, 3)` widened.
        measured: `(num_persons, num_joints)` cleared where a length contradicts.
    """
    num_bones = len(body.bones)
    room = np.empty((4, len(body.shares)))
    lengths_m, variances = np.empty(num_bones), np.empty(num_bones)
    for person in range(len(joints_m)):
        expect_lengths(bones_m[person], counts[person], body, room, lengths_m, variances)
        keep_lengths(lengths_m, body, joints_m[person], covariance_m2[person], measured[person])


@kernel
def stature_of(joints_m: Floats, body: Proportions, logs: Floats) -> float:
    """Return the stature that limbs `(num_joints, 3)` have in the median; 0 without any.

    `logs` is scratch, `(num_joints,)` or longer.
    """
    count = 0
    for bone in range(len(body.bones)):
        kind = body.kinds[bone]
        if kind < 0:
            continue
        squares = 0.0
        for axis in range(3):
            between = joints_m[body.bones[bone, 0], axis] - joints_m[body.bones[bone, 1], axis]
            squares += between * between
        if squares > SHORTEST_M**2:  # not for NaN
            logs[count] = math.log(squares) / 2 - body.shares[kind]
            count += 1
    return math.exp(median_of(logs, count)) if count else 0.0


@kernel
def median_of(values: Floats, count: int) -> float:
    """Return the median of the first `count` values, which it puts in order."""
    for index in range(1, count):
        value = values[index]
        place = index
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value
    half = count // 2
    return float(values[half] if count % 2 else (values[half - 1] + values[half]) / 2)
