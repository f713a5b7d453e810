"""The errors that a smoother states.

A smoother averages over slots what the filter takes for independent. The filter's published
covariance has two parts (`filter.covariance_inflation`, `filter.lasting`): its own, times a factor,
and the errors that views repeat, which no number of slots averages out:

    S = f^2 (P + 0.3 g (P0 - P)) + R + g (R' - R)

with P of the smoother, P0 of the filter, and g, R and R' of `filter.lasting` (fit:
`lab/experiments/2026-11-24-smoothed-covariances.md`).
"""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats

# tuned: share | lab/experiments/2026-11-24-smoothed-covariances.md | not measured
SHARED = 0.3  # of what smoothing gains, where g is 1: errors that slots share


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
