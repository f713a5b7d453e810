"""Covariance inflation: a factor on the standard deviations that are reported.

The filter is best when it takes keypoints for noisier than they are (`learned_noise.CAUTION`) and
people for less predictable than a predictor knows them to be, so what it computes is too large. A
constant corrects that on average (fit: `lab/experiments/2026-11-22-stated-errors.md`).

What is left depends on what people do: who stands still is known better than reported, who runs or
turns worse. Innovations show it without labels: the distance of each keypoint from where the filter
predicts it, beside the expected distance. Both are added up for each person over the last seconds,
in metres, so that uncertain joints count as much as they do in a mean error; their quotient
corrects the constant (fit: `lab/experiments/2026-11-22-inflation-by-person.md`). Only keypoints
whose prediction is less certain than they are count: the others measure the detector.
"""

from __future__ import annotations

import math

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.learned_noise import MEDIAN, NORMAL
from e3pose.estimate.filter.projected import Beside

# Mean error over mean stated error. A predictor explains a part of the motion of the joints that it
# steers.
# tuned: factor, factor | lab/experiments/2026-11-22-stated-errors.md | half and twice
STEERED, ALONE = 0.75, 0.85
ACTUAL, EXPECTED = 0, 1  # layout: of `Belief.innovations`
# Innovations over expected ones where the reported error is the actual one. It is below 1 as
# uncertainty is mostly along one line of sight, and errors in two directions are longer.
# tuned: ratio | 0.87 between simulated scenes and motion capture,
#   lab/experiments/2026-11-22-inflation-by-person.md; since then not recorded | inflation by
#   person
USUAL = 0.9
# tuned: m | simulated, 36 replays: 0.4, 1.2, 4 m leave a spread of 0.038, 0.039, 0.043,
#   lab/experiments/2026-11-22-inflation-by-person.md | inflation by person
PRIOR_M = 0.4  # of expected innovations that the constants count for: half a look at a person
# tuned: s | simulated, 36 replays, lab/experiments/2026-11-22-inflation-by-person.md | inflation
#   by person
MEMORY_S = 1.5  # of the sums: people who stand begin to walk
# tuned: factor | not recorded | inflation by person
MOST = 2.0  # the learned factor, and its inverse
# tuned: ratio | simulated: 3 or 8 are no better, lab/experiments/2026-11-22-inflation-by-person.md
#   | half and twice
CLIP = 5.0  # times the expected innovation: a wild keypoint teaches no more
# tuned: m | not recorded | half and twice
MOST_M = 0.3  # nor does a joint count for more that nothing is known of
# tuned: share | simulated: 0.35 or 0.8 are no better,
#   lab/experiments/2026-11-22-inflation-by-person.md | half and twice
LEAST_SHARE = 0.5  # of an innovation's variance that must be the prediction's
OWN_SHARE = MEDIAN / NORMAL  # of the variance that the filter takes for a keypoint's own
MEAN = math.pi / 2  # definition: squared mean of a distance over the variance of either coordinate


@kernel
def fade_sums(sums_m: Floats, dt: float) -> None:
    """Forget a part of the sums of a row of `Belief.innovations`."""
    for total in range(len(sums_m)):
        sums_m[total] *= math.exp(-dt / MEMORY_S)


@kernel
def add_innovation(found: Beside, own_px2: float, drift_share: float, sums_m: Floats) -> None:
    """Add the innovation of one keypoint; `own_px2` is its variance without the bias."""
    variance_px2 = found.variance_px2 * spread_factor(drift_share, 1.0) ** 2
    total = variance_px2 + own_px2
    if variance_px2 > LEAST_SHARE * total:
        expected_px = math.sqrt(MEAN * total)
        off = math.sqrt(found.du * found.du + found.dv * found.dv) / expected_px
        squares = found.ux * found.ux + found.uy * found.uy + found.uz * found.uz
        squares += found.vx * found.vx + found.vy * found.vy + found.vz * found.vz
        expected_m = min(expected_px / math.sqrt(squares / 2.0), MOST_M)
        sums_m[ACTUAL] += min(off, CLIP) * expected_m
        sums_m[EXPECTED] += expected_m


@kernel
def learned_factor(innovations: Floats) -> float:
    """Return the factor on all reported standard deviations of one person.

    Args:
        innovations: `(2,)` of `Belief`.
    """
    factor = (innovations[ACTUAL] / USUAL + PRIOR_M) / (innovations[EXPECTED] + PRIOR_M)
    return float(min(max(factor, 1 / MOST), MOST))


@kernel
def spread_factor(drift_share: float, of_person: float) -> float:
    """Return the factor that makes a joint's standard deviations consistent with its errors.

    Args:
        drift_share: of `Belief`; a joint that was not steered has all of its process noise.
        of_person: see `learned_factor`.
    """
    return (ALONE if drift_share == 1.0 else STEERED) * of_person
