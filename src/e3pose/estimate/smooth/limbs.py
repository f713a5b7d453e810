"""Limbs of a smoothed person are as long as they can be, in every slot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.estimate.filter.bones import proportions_of
from e3pose.estimate.filter.proportions import kept, median_lengths_m
from e3pose.estimate.filter.tree import grow
from e3pose.estimate.smooth.points import UNKNOWN_SIGMA_M
from e3pose.model.proportions import LEAST_M, MOST_M
from e3pose.model.skeleton import Skeleton
from e3pose.model.take import Motion

# tuned: m | not recorded | not measured
TELLING_M = 0.05  # a joint that is known better than this tells the lengths of its limbs


def keep_limbs(motion: Motion, skeleton: Skeleton) -> Motion:
    """Return the motion with limbs of the person's lengths.

    What is missing stays so; scores and origins are as they were; a joint that had to move is as
    much less certain. Bodies that are nobody's, by the median of their limbs, stay as they are.

    Args:
        motion: of one person.
        skeleton: of its joints.
    """
    body = proportions_of(skeleton, grow(skeleton))
    sigma_m = np.where(np.isfinite(motion.sigma_m), motion.sigma_m, UNKNOWN_SIGMA_M)
    telling = motion.known & (sigma_m < TELLING_M)
    lengths_m, counts = median_lengths_m(body, motion.joints_m, telling)
    told = (body.kinds >= 0) & (counts > 0)
    if told.any():
        shares = np.exp(body.shares[body.kinds[told]])
        if not LEAST_M <= np.median(lengths_m[told] / shares) <= MOST_M:
            return motion
    joints_m, covariance_m2, _ = kept(
        body,
        np.tile(lengths_m, (len(motion), 1)),
        np.tile(counts, (len(motion), 1)),
        motion.joints_m,
        sigma_m[..., None, None] ** 2 * np.eye(3),
        motion.known,
    )
    wider_m = np.sqrt(np.trace(covariance_m2, axis1=-2, axis2=-1) / 3)
    return replace(
        motion,
        joints_m=joints_m,
        sigma_m=np.where(np.isfinite(motion.sigma_m), wider_m, motion.sigma_m),
    )
