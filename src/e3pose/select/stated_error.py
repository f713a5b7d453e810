"""The mean error that the estimator recently stated.

A target error is compared with what the estimator expects to state, which errs both ways: more
cameras look than the expectation needs, orders arrive for people who moved, cameras fail. What was
stated says how far off that was.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.select.kernels import foresight as kernels

# tuned: s | lab/experiments/2026-11-22-inflation-by-person.md | 3 and 20 s, with their
#   `CORRECTION`, are no better
MEMORY_S = 8.0  # of the mean
# tuned: power | lab/experiments/2026-11-22-inflation-by-person.md | 2 and 12, with their
#   `MEMORY_S`, are no better
CORRECTION = 5.0  # powers of target over stated error that the aim differs from the target
# tuned: factor | by reasoning | by the truth of `one-sided`, targets of 15 and 40 mm, 1.2: 1 to 2 %
#   less error with as much as 2 % more cameras; 4, and other scenes: the same
MOST = 2.0  # times the target, and its inverse


def stated_error_m(covariance_m2: Floats) -> float:
    """Return the mean error in metres that covariances state; NaN without people.

    Args:
        covariance_m2: `(num_persons, num_joints, 3, 3)` of the people shown; NaN where unknown.
    """
    return float(kernels.stated_error(np.ascontiguousarray(covariance_m2, dtype=np.float64)))


@dataclass(frozen=True, slots=True)
class StatedError:
    """Mean error stated in the last seconds, from the end of the warm-up on.

    Attributes:
        mean_m: metres; 0 before the first.
        filled: in [0, 1): share of the memory that there was something to remember in.
    """

    mean_m: float = 0.0
    filled: float = 0.0

    def after(self, newest_m: float, interval_s: float) -> StatedError:
        """Return the mean with another slot.

        Args:
            newest_m: what was stated in it, from `stated_error_m`; NaN where nobody is known.
            interval_s: seconds per slot.
        """
        if math.isnan(newest_m):
            return self
        share = 1 - math.exp(-interval_s / MEMORY_S)
        filled = self.filled + share * (1 - self.filled)
        mean_m = self.mean_m + share / filled * (newest_m - self.mean_m)
        return StatedError(mean_m, filled)

    def aim_m(self, target_m: float) -> float:
        """Return the expected error to aim at, so that the stated error meets the target.

        Proportional in the logarithm: of what an uncorrected aim would miss the target by, a sixth
        is left. An error that was stated for a short time only corrects little, so that the
        certainty which the warm-up leaves behind is not made up for.
        """
        if not self.mean_m > 0:
            return target_m
        factor = math.pow(target_m / self.mean_m, CORRECTION * self.filled)
        return target_m * min(max(factor, 1 / MOST), MOST)
