"""Where a view is off, it stays so for a while: what that means for the next look.

Errors of a detector have a memory (`model.noise.ErrorMemory`). The part that lasts seconds is
learned here, as a slow bias per view, person and joint, and taken off. The part that comes and goes
counts for less the sooner a view looks again: n looks of a noise with memory tell as much as one
look of n times its variance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from e3pose.model.noise import DIGITS, ErrorMemory

Floats = NDArray[np.float64]

LEARNED_S = 1.2  # how long it takes to learn a bias
SHORTEST_S = 1e-3  # for looks of one time
CLIP_SIGMAS = 3.0  # a wild keypoint teaches no more than one this far off
REPEATED = 2 / 5  # of the quick part: joints and views average the rest of its repetition out
LEFT = 8 / 45  # of the lasting part, once its learned bias is taken off: the mean over time
REMOVED = 8 / 9  # of the lasting part, by a bias that was learned just before


class MemoryTerms(NamedTuple):
    """What the filter derives from an `ErrorMemory`, for its kernels.

    With l and q the lasting and the quick share of the variance and t the time since the view
    looked before, the variance of a keypoint is multiplied in the update by

        f(t) = (1 - l - q) + (1 - REPEATED) q + LEFT l  +  REPEATED q coth(t / 2 quick_s)
             =                fresh                     +      quick   coth(t / 2 quick_s)

    as a noise of correlation time T, sampled every t, is worth a white one of coth(t / 2T) times
    its variance. A bias that was learned t ago leaves 1 - REMOVED l exp(-2 t / lasting_s) of the
    variance: that is what residuals are compared with where noise is learned.

    REPEATED, LEFT and REMOVED were tuned on simulated scenes with the default memory (fresh 0.45,
    quick 0.18, removed 0.4); for other shares they are carried over.

    Attributes:
        lasting_s: until a bias is down to 1/e.
        most: of the first residual that may become a bias: the lasting share.
        removed: share of a keypoint's variance that a bias learned just before takes off.
        fresh: share of the variance that every look has.
        quick: share of the variance that repeats itself.
        quick_s: correlation time of that.
    """

    lasting_s: float
    most: float
    removed: float
    fresh: float
    quick: float
    quick_s: float


def memory_terms(memory: ErrorMemory) -> MemoryTerms:
    """Return the filter's constants for a detector whose errors last so long."""
    lasting, quick = memory.lasting_share, REPEATED * memory.quick_share
    return MemoryTerms(
        lasting_s=float(memory.lasting_s),
        most=float(lasting),
        removed=round(REMOVED * lasting, DIGITS),
        fresh=round(1 - lasting - quick + LEFT * lasting, DIGITS),
        quick=round(quick, DIGITS),
        quick_s=float(memory.quick_s),
    )


def inflation(since_s: Floats, terms: MemoryTerms) -> Floats:
    """Return the factor on a keypoint's variance, `(*batch)`, so long after the look before."""
    times = np.clip(since_s, SHORTEST_S, terms.lasting_s)
    return np.asarray(terms.fresh + terms.quick / np.tanh(times / (2 * terms.quick_s)))
