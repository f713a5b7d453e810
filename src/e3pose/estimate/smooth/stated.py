"""What a smoother states of its errors.

A smoother averages over slots what the filter takes for independent. The filter's published
covariance has two parts (`filter.covariance_inflation`, `kernels.repeated_errors`): its own, times
a factor, and the errors that views repeat, which no number of slots averages out:

    S = f^2 (P + 0.3 g (P0 - P)) + R + g (R' - R)

with P of the smoother, P0 of the filter, R the errors that views repeat as the noise file has them,
R' as they are in the biases learned of this site, and g how much larger these biases are than
those of a detector whose errors are as the file says (fit: `docs/experiments/
2026-11-24-smoothed-covariances.md`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.base import Posterior

Floats = NDArray[np.float64]

USUAL, SPAN = 0.40, 0.15  # of `Posterior.bias_share`: where g is 0, and from there where it is 1
MOST = 2.0  # g
SHARED = 0.3  # of what smoothing gains, where g is 1: errors that slots share
MEMORY_S = 3.0  # of the mean of `bias_share`
PRIOR_S = 0.2  # that the usual share counts for in it


@dataclass(frozen=True, slots=True)
class Lasting:
    """The mean of `Posterior.bias_share` over the last seconds.

    Attributes:
        total: of the shares, times seconds.
        seconds: that were added up.
        time_s: of the newest slot; NaN before the first.
    """

    total: float = USUAL * PRIOR_S
    seconds: float = PRIOR_S
    time_s: float = math.nan

    def after(self, posterior: Posterior) -> Lasting:
        """Return the mean with one more slot."""
        passed_s = posterior.time_s - self.time_s
        if not 0 < passed_s < MEMORY_S:
            passed_s = 0.0
        left = math.exp(-passed_s / MEMORY_S)
        later = Lasting(left * self.total, left * self.seconds, posterior.time_s)
        if math.isnan(posterior.bias_share):
            return later
        total = later.total + passed_s * posterior.bias_share
        return replace(later, total=total, seconds=later.seconds + passed_s)

    @property
    def excess(self) -> float:
        """How much larger biases are than usual: g above."""
        return min(max((self.total / self.seconds - USUAL) / SPAN, 0.0), MOST)


def own_m2(filtered_m2: Floats, smoothed_m2: Floats, inflation: Floats, excess: float) -> Floats:
    """Return the first part of S, `(*batch, 3, 3)` square metres.

    Args:
        filtered_m2: `(*batch, 3, 3)` P0.
        smoothed_m2: `(*batch, 3, 3)` P.
        inflation: `(*batch)` f.
        excess: g.
    """
    shared_m2 = SHARED * excess * (filtered_m2 - smoothed_m2)
    return np.asarray(inflation[..., None, None] ** 2 * (smoothed_m2 + shared_m2))


def repeated_m2(repeated_m2: Floats, lasting_m2: Floats, excess: float) -> Floats:
    """Return the second part of S; arguments as in `Posterior`, `(*batch, 3, 3)` each."""
    return np.asarray(repeated_m2 + excess * (lasting_m2 - repeated_m2))
