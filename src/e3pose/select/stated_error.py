"""How large the errors were that the estimator stated of the people it showed lately.

A target error is compared with what the estimator expects to state, which errs both ways: more
cameras look than the expectation needs, orders arrive for people who moved, cameras fail. What was
stated says how far off that was.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MEMORY_S = 3.0  # of the mean
CORRECTION = 2.0  # powers of target over stated error that the aim differs from the target
MOST = 2.0  # times the target, and its inverse


def recent_error_m(before_m: float, covariance_m2: Floats, interval_s: float) -> float:
    """Return the mean error stated in the last seconds, in metres; NaN before anybody was shown.

    Args:
        before_m: what was returned for the slot before.
        covariance_m2: `(num_persons, num_joints, 3, 3)` of the people shown; NaN where unknown.
        interval_s: seconds per slot.
    """
    from e3pose.select.kernels.foresight import stated_error

    newest_m = stated_error(np.ascontiguousarray(covariance_m2, dtype=np.float64))
    if math.isnan(newest_m):
        return before_m
    if math.isnan(before_m):
        return newest_m
    return before_m + (1 - math.exp(-interval_s / MEMORY_S)) * (newest_m - before_m)


def aim_m(target_m: float, stated_m: float) -> float:
    """Return the expected error to choose cameras for, so that what is stated meets the target.

    Proportional in the logarithm: of what an uncorrected aim would miss the target by, a third is
    left. A longer lead reacts later, but no more strongly, as the mean is longer than any lead.

    Args:
        target_m: the error asked for.
        stated_m: `recent_error_m`; NaN leaves the target alone.
    """
    if math.isnan(stated_m) or stated_m <= 0:
        return target_m
    factor = math.pow(target_m / stated_m, CORRECTION)
    return target_m * min(max(factor, 1 / MOST), MOST)
