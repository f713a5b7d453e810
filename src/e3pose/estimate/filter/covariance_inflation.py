"""Covariance inflation: a factor on the standard deviations that are reported.

The filter is best when it takes keypoints for noisier than they are (`learned_noise.CAUTION`) and
people for less predictable than a predictor knows them to be, so what it computes is too large.
Conditions that a factor could depend on (size in the image, speed, time unmeasured, number of
views) are covered by the learned noise and the steered process noise: a regression on them states
no better. Fit: `docs/experiments/2026-11-22-stated-errors.md`.
"""

from __future__ import annotations

import numpy as np

from e3pose.estimate.filter.state import Belief, Floats

# Mean error over mean stated error. A predictor explains a part of the motion of the joints that it
# steers.
STEERED, ALONE = 0.75, 0.85


def spread_factor(belief: Belief) -> Floats:
    """Return `(num_tracks, num_joints)`: the factor that makes standard deviations honest.

    A joint that was not steered has all of its process noise (`steer`).
    """
    return np.where(belief.drift_share == 1.0, ALONE, STEERED)
