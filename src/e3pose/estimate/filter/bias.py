"""Biases of views: keypoint errors that persist, as states of the filter.

Errors of a detector have a memory (`model.noise.ErrorMemory`). The part that lasts seconds is
learned here, as a slow bias per view, person and joint, and taken off. The part that comes and goes
counts for less the sooner a view looks again: n looks of a noise with memory tell as much as one
look of n times its variance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.outliers import MEASURED_SIGMAS
from e3pose.estimate.filter.projected import Beside
from e3pose.model.noise import DIGITS, ErrorMemory

# tuned: s | simulated: 0.6, 1.2, 2 s within 1 % | biases
LEARNED_S = 1.2  # how long it takes to learn a bias
SHORTEST_S = 1e-3  # numerics: for looks of one time
# tuned: share | the share that lasts, residuals of OpenPose | biases
MOST_LEARNED = 0.45  # of the first residual, as it was tuned
# tuned: share | simulated: coverage alike with all and one camera; no effect on the error | quick
#   repetition
REPEATED = 2 / 5  # of the quick part: joints and views average the rest of its repetition out
# tuned: share | simulated: coverage alike with all and one camera; no effect on the error | half
#   and twice
LEFT = 8 / 45  # of the lasting part, once its learned bias is taken off: the mean over time
# tuned: share | simulated with known noise, five scenes, seed 701: found within a fifth | half and
#   twice
REMOVED = 8 / 9  # of the lasting part, by a bias that was learned just before
# Of the lasting part, what a camera that looks again tells nothing new about, as no bias learns it:
# chosen by the cameras that are selected (lab/experiments/2026-11-23-agility.md).
# tuned: share | lab/experiments/2026-11-23-agility.md | worth of a look again
UNLEARNED = 0.1


class MemoryTerms(NamedTuple):
    """Constants that the kernels derive from an `ErrorMemory`.

    With l the lasting share of the variance, at most MOST_LEARNED, q the quick share and t the
    time since the view looked before, the update multiplies the variance of a keypoint by

        f(t) = (1 - l - q) + (1 - REPEATED) q + LEFT l  +  REPEATED q coth(t / 2 quick_s)
             =                fresh                     +      quick   coth(t / 2 quick_s)

    as a noise of correlation time T, sampled every t, is worth a white one of coth(t / 2T) times
    its variance. A bias that was learned t ago leaves 1 - REMOVED l exp(-2 t / lasting_s) of the
    variance: that is what residuals are compared with where noise is learned. A selection of
    cameras counts with f(t) + UNLEARNED l coth(t / 2 lasting_s): a view from another direction has
    other errors, which no bias learned from the views at hand knows.

    REPEATED, LEFT and REMOVED were tuned on simulated scenes with the default memory (fresh 0.45,
    quick 0.18, removed 0.4); for other shares they are carried over. Where more lasts than
    MOST_LEARNED, the rest counts as new: a bias that learns it all states errors that are too
    small (lab/experiments/2026-11-22-error-memory.md).

    Attributes:
        lasting_s: until a bias is down to 1/e.
        most: of the first residual that may become a bias: l.
        removed: share of a keypoint's variance that a bias learned just before takes off.
        fresh: share of the variance that every look has.
        quick: share of the variance that repeats itself.
        quick_s: correlation time of that.
        unlearned: share of the variance that lasts and is in no bias.
    """

    lasting_s: float
    most: float
    removed: float
    fresh: float
    quick: float
    quick_s: float
    unlearned: float


def memory_terms(memory: ErrorMemory) -> MemoryTerms:
    """Return the filter's constants for an error memory."""
    lasting = min(memory.lasting_share, MOST_LEARNED)
    quick = REPEATED * memory.quick_share
    return MemoryTerms(
        lasting_s=float(memory.lasting_s),
        most=float(lasting),
        removed=round(REMOVED * lasting, DIGITS),
        fresh=round(1 - lasting - quick + LEFT * lasting, DIGITS),
        quick=round(quick, DIGITS),
        quick_s=float(memory.quick_s),
        unlearned=round(UNLEARNED * lasting, DIGITS),
    )


@kernel
def inflation(since_s: float, terms: MemoryTerms) -> float:
    """Return the factor on a keypoint's variance by the time since the previous look."""
    since_s = SHORTEST_S if since_s < SHORTEST_S else since_s
    since_s = terms.lasting_s if since_s > terms.lasting_s else since_s
    return terms.fresh + terms.quick / math.tanh(since_s / (2 * terms.quick_s))


@kernel
def worth_inflation(since_s: float, terms: MemoryTerms) -> float:
    """Return the factor by which a selector counts a keypoint's variance, see `MemoryTerms`."""
    repeated = math.tanh(max(since_s, SHORTEST_S) / (2 * terms.lasting_s))
    return inflation(since_s, terms) + terms.unlearned / repeated


@kernel
def left_over(since_s: float, terms: MemoryTerms) -> float:
    """Return the share of a keypoint's variance that its learned bias does not remove."""
    return 1.0 - terms.removed * math.exp(-2.0 * since_s / terms.lasting_s)


@kernel
def learning_rate(since_s: float, terms: MemoryTerms) -> float:
    """Return the share of a residual that a bias learns, by the time since the previous look."""
    return float(min(1.0 - math.exp(-since_s / LEARNED_S), terms.most))


@kernel
def learn_bias(found: Beside, rate: float, variance: float, bias_px: Floats) -> None:
    """Let one keypoint beside its updated joint teach the bias `(2,)` of its view.

    The less sure a joint, the less is the view to blame. `rate` is of `learning_rate`, `variance`
    of the keypoint in px2.
    """
    off = math.sqrt((found.du * found.du + found.dv * found.dv) / variance) / MEASURED_SIGMAS
    blame = rate * variance / (variance + found.variance_px2) / max(off, 1.0)
    bias_px[0] += blame * found.du
    bias_px[1] += blame * found.dv
