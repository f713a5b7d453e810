"""Where a view is off, it stays so for a while: what that means for the next look.

Residuals of a detector have a memory. Of their variance about 45 % lasts seconds (2.5 s), 45 % a
tenth of a second; only 10 % is new in every frame. What lasts is learned here, as a slow bias per
view, person and joint, and taken off. What comes and goes counts for less the sooner a view looks
again: n looks of a noise with memory tell as much as one look of n times its variance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LASTS_S = 2.5  # until a bias is down to 1/e
LEARNED_S = 1.2  # how long it takes to learn one
MOST = 0.45  # of the first residual: the share of the variance that lasts
FRESH, QUICK = 0.45, 0.18  # shares of the variance: of every look; of a tenth of a second
QUICK_S = 0.1
SHORTEST_S = 1e-3  # for looks of one time
CLIP_SIGMAS = 3.0  # a wild keypoint teaches no more than one this far off


def inflation(since_s: Floats) -> Floats:
    """Return the factor on a keypoint's variance, `(*batch)`, so long after the look before.

    A noise of memory T, looked at every t, is worth a white one of coth(t / 2T) times its variance.
    """
    times = np.clip(since_s, SHORTEST_S, LASTS_S)
    return np.asarray(FRESH + QUICK / np.tanh(times / (2 * QUICK_S)))
