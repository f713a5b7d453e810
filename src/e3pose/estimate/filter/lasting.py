"""Errors that last longer than the noise file says, as the learned biases show them.

A noise file says how much of a detector's errors lasts. Where people sit, crowd or are hidden, more
does, in all views alike, which no bias learned from differences of views can show as a whole; but
biases grow with it. So their mean square over the variance of a keypoint is followed, and where it
is larger than usual, what is stated grows:

    S + g (R' - R)

with R the errors that views repeat as the noise file has them (`filter.repeated_errors`), R' as
large as the biases are, and g how much larger these are than those of a detector whose errors are
as the file says (fit: `lab/experiments/2026-11-24-smoothed-covariances.md`). Poses at once, whose
own covariance is larger than that of smoothed ones, need a quarter of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.estimate.filter.covariance_inflation import MEMORY_S

# tuned: share, share | lab/experiments/2026-11-24-smoothed-covariances.md | half and twice
USUAL, SPAN = 0.40, 0.15  # of the share of biases: where g is 0, and from there where it is 1
# tuned: factor | lab/experiments/2026-11-24-smoothed-covariances.md | half and twice
MOST = 2.0  # g
# tuned: share | lab/experiments/2026-11-24-smoothed-covariances.md | in the radius by the truth of
#   `lab`, all cameras: 81 %; 77 with 0.2, 45 with 0
AT_ONCE = 0.25  # of g for poses that no later slot smooths: their own covariance is larger


@dataclass(frozen=True, slots=True)
class Lasting:
    """The mean square of biases over the variance of a keypoint, of the last seconds.

    Attributes:
        total: of the shares, times seconds.
        seconds: that were added up.
    """

    total: float = 0.0
    seconds: float = 0.0

    def after(self, share: float, passed_s: float) -> Lasting:
        """Return the mean with one more slot.

        Args:
            share: of the slot; NaN where nobody is shown.
            passed_s: since the slot before; NaN before the first.
        """
        if not 0 < passed_s < MEMORY_S:
            passed_s = 0.0
        left = math.exp(-passed_s / MEMORY_S)
        fresh_s = 0.0 if math.isnan(share) else passed_s
        total = left * self.total + (fresh_s * share if fresh_s else 0.0)
        return Lasting(total, left * self.seconds + fresh_s)

    @property
    def share(self) -> float:
        """The mean share; before there is one, the usual."""
        return self.total / self.seconds if self.seconds > 0 else USUAL

    @property
    def excess(self) -> float:
        """The ratio of biases to their usual size: g above."""
        return excess_of(self.share)


def excess_of(share: float) -> float:
    """Return g above of a mean share."""
    return min(max((share - USUAL) / SPAN, 0.0), MOST)


def grown_m2(repeated_m2: Floats, lasting_m2: Floats, excess: float) -> Floats:
    """Return R + g (R' - R), `(*batch, 3, 3)` square metres; arguments as in `Posterior`."""
    return np.asarray(repeated_m2 + excess * (lasting_m2 - repeated_m2))
