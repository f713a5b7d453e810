"""Rauch-Tung-Striebel smoothing of stored poses, joint by joint.

A store keeps where joints were thought to be and how sure that was, not velocities and not how
joints hang together. Joint by joint, both follow from the answers: with the position's mean m- and
variance p- expected from the slot before, and m, s2 as kept,

    k = 1 - s2 / p-,    (position, velocity) <- expected + (1, c- / p-) (m - m-)

with c- the covariance of position and velocity: a measurement of a position moves the velocity by
regression, whatever it was. So the kept answers are never taken for new measurements, which they
are not. Each joint moves by itself, as `filter.motion.alone` has it; axes share one variance.
Answers without a variance, which know nothing of the slots before, are measurements of
`UNKNOWN_SIGMA_M`.

Where a store keeps the joints' dynamics, too (`model.dynamics`), velocity and covariance are those
of the whole body's filter: they know how a joint moved that no view showed, because others did.
"""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.estimate.filter.motion import alone, fading
from e3pose.estimate.filter.tree import grow
from e3pose.estimate.smooth.gaps import stretches
from e3pose.estimate.smooth.rauch import Expected, expect, step_back
from e3pose.model.dynamics import covariance_of
from e3pose.model.skeleton import Skeleton
from e3pose.model.take import FILLED, Motion

# tuned: m | not recorded | not measured
UNKNOWN_SIGMA_M = 0.03  # of an estimator that states none: the usual error of two views
# tuned: m/s | not recorded | not measured
FIRST_SPEED_MPS = 1.0  # standard deviation of a velocity of which nothing is known
LEAST_NEWS = 1e-3  # numerics: of a slot, as a share of the variance expected


def smooth_points(motion: Motion, skeleton: Skeleton, interval_s: float) -> Motion:
    """Return the motion smoothed by all of its slots.

    Filled joints are no evidence: they are placed by those before and after, and stay marked.

    Args:
        motion: of one person.
        skeleton: of its joints.
        interval_s: seconds per slot.
    """
    drift, lasts_s = alone(grow(skeleton))
    known = motion.known
    begins = np.zeros_like(known)
    for joint in range(known.shape[1]):
        for start, _ in stretches(known[:, joint], 0):
            begins[start, joint] = True
    tells = known & (motion.origin != FILLED)
    means, covariances, expected = _forward(
        np.where(tells[..., None], motion.joints_m, np.nan),
        motion.sigma_m,
        motion.dynamics,
        begins,
        *fading(drift, lasts_s, interval_s),
    )
    joints_m = np.where(known[..., None], motion.joints_m, np.nan)
    sigma_m = motion.sigma_m.copy()
    mean, covariance = means[-1], covariances[-1]
    for slot in range(len(known) - 1, -1, -1):
        if slot < len(known) - 1:
            goes_on = known[slot] & known[slot + 1] & ~begins[slot + 1]
            back, spread = step_back(
                means[slot], covariances[slot], expected[slot + 1], mean, covariance
            )
            mean = np.where(goes_on[:, None, None], back, means[slot])
            covariance = np.where(goes_on[:, None, None], spread, covariances[slot])
        here = known[slot]
        joints_m[slot, here] = mean[here, 0]
        stated = here & np.isfinite(motion.sigma_m[slot])
        sigma_m[slot, stated] = _stated_m(
            motion.sigma_m[slot, stated], covariances[slot][stated, 0, 0], covariance[stated, 0, 0]
        )
    return Motion(motion.track_id, motion.first, joints_m, sigma_m, motion.scores, motion.origin)


def _stated_m(before_m: Floats, filtered_m2: Floats, smoothed_m2: Floats) -> Floats:
    """Return the stated standard deviations after smoothing, `(num,)`.

    What was stated beyond what the filter knew are errors that views repeat, which no number of
    slots averages out (`smooth.stated`): they stay. What was stated below it is a factor.
    """
    factor = np.minimum(before_m**2 / filtered_m2, 1.0)
    return np.sqrt(before_m**2 - factor * (filtered_m2 - np.maximum(smoothed_m2, 0.0)))


def _forward(
    joints_m: Floats,
    sigma_m: Floats,
    dynamics: Floats | None,
    begins: Flags,
    move: Floats,
    noise: Floats,
) -> tuple[list[Floats], list[Floats], list[Expected]]:
    """Return the filtered state after each slot, `(num_joints, 2, 3)` and `(num_joints, 2, 2)`.

    With it what was expected of each slot, from the one before; the first entry says nothing.
    """
    num_joints = joints_m.shape[1]
    mean, covariance = np.zeros((num_joints, 2, 3)), np.tile(np.eye(2), (num_joints, 1, 1))
    means, covariances, expectations = [], [], []
    for slot, (place_m, sigma, new) in enumerate(zip(joints_m, sigma_m, begins, strict=True)):
        across = covariance @ np.swapaxes(move, -1, -2)
        expected = expect(move @ mean, move @ across + noise, across)
        mean, covariance = _taken_in(expected, place_m, sigma)
        if new.any():
            variance = np.where(np.isfinite(sigma), sigma, UNKNOWN_SIGMA_M) ** 2
            mean[new, 0], mean[new, 1] = place_m[new], 0.0
            covariance[new] = 0.0
            covariance[new, 0, 0], covariance[new, 1, 1] = variance[new], FIRST_SPEED_MPS**2
        if dynamics is not None:
            told = np.isfinite(dynamics[slot]).all(axis=-1) & np.isfinite(place_m).all(axis=-1)
            mean[told, 1] = dynamics[slot, told, :3]
            covariance[told] = covariance_of(dynamics[slot, told])
        means.append(mean)
        covariances.append(covariance)
        expectations.append(expected)
    return means, covariances, expectations


def _taken_in(expected: Expected, place_m: Floats, sigma_m: Floats) -> tuple[Floats, Floats]:
    """Return the filtered state after a slot, from its published state; NaN adds nothing."""
    before = expected.covariance[:, 0, 0]
    measured: Flags = np.asarray(np.isfinite(place_m).all(axis=-1))
    stated = np.isfinite(sigma_m)
    measurement = before * UNKNOWN_SIGMA_M**2 / (before + UNKNOWN_SIGMA_M**2)
    after = np.where(stated, np.where(stated, sigma_m, 1.0) ** 2, measurement)
    share = 1 - np.clip(after / before, 0.0, 1 - LEAST_NEWS)  # information of the slot: k above
    share = np.where(measured, share, 0.0)
    column = expected.covariance[:, :, 0] / before[:, None]  # (1, c- / p-)
    gone = np.where(measured[:, None], place_m - expected.mean[:, 0], 0.0)
    gone *= np.where(measured & ~stated, share, 1.0)[:, None]  # a measurement is not yet the answer
    mean = expected.mean + column[:, :, None] * gone[:, None]
    less = (share * before)[:, None, None] * column[:, :, None] * column[:, None, :]
    return mean, expected.covariance - less
