"""Learned noise: a factor on each camera's keypoint sigma.

After the update of a slot each keypoint is compared with where all other evidence puts the joint:
the residual of the update, divided by what the keypoint itself left of it (its leverage). Its
variance is that of the keypoint plus that of the joint without it, so a keypoint teaches by the
square of the share that is its own: where the joint is the vaguer of the two, the process noise
would be learned. The median is what is compared, so that wild joints count as one each.

A camera's factor is drawn to the mean of all cameras, and that to the noise file: most sites run
one detector, and a camera that seldom looks knows little by itself. What a score is worth is of
the detector: one tilt for all cameras makes certain keypoints better and uncertain ones worse than
the file states, or the other way round.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from e3pose.estimate.filter.state import Floats
from e3pose.runtime.deferred import Deferred

if TYPE_CHECKING:
    from e3pose.estimate.filter.kernels import learned_noise as kernels
else:
    kernels = Deferred("e3pose.estimate.filter.kernels.learned_noise")

LOG, COUNT = 0, 1  # layout: of the last axis of `Belief.noise`
ALIKE = 60.0  # keypoints that the other cameras' mean counts for
MEMORY = 15_000.0  # keypoints of a camera: some minutes of two people who are seen all the time
MOST = 5.0  # the factor and its inverse
MOST_LEVERAGE = 0.9  # numerics
# The filter takes joints for independent, which they are not: it is best where it takes keypoints
# for this much noisier than they are. Shipped files hold it already where people are large.
CAUTION = 4 / 3
NORMAL = 2 * np.log(2)  # definition: median squared length of two standard normal coordinates
MEDIAN = 0.8 * NORMAL / CAUTION**2  # of squared residuals where the factor is right
SLOPE = np.log(2)  # definition: of the share beyond their median, by the logarithm of sigma
MIDDLE_SCORE, SCORE_REACH = 0.7, 0.25  # where the tilt does nothing, and how far it reaches
STEEPEST = 3.0  # the tilt at its ends, and its inverse
LEAST_KNOWN = 50.0  # definition: keypoints from which on a camera's factor is worth telling


def nothing_known(num_cameras: int) -> Floats:
    """Return `(num_cameras + 1, 2)` before the first slot, as in `Belief.noise`."""
    return np.zeros((num_cameras + 1, 2))


def factors(noise: Floats, weight: float) -> Floats:
    """Return `(num_cameras,)` factors on the sigma of the noise file.

    Args:
        noise: `Belief.noise`.
        weight: keypoints that the file counts for.
    """
    logs = np.empty(len(noise))
    kernels.find_logs(noise, weight, logs)
    return np.asarray(np.exp(logs[:-1]))


def found(noise: Floats, weight: float) -> Floats:
    """Return `(num_cameras,)` sigma of the keypoints over the file's; NaN where too little is seen.

    Arguments are those of `factors`.
    """
    factor = np.empty(len(noise) - 1)
    kernels.stated_factors(noise, weight, factor)
    return factor
