"""Covariance inflation: a factor on the standard deviations that are reported.

The filter is best when it takes keypoints for noisier than they are (`learned_noise.CAUTION`) and
people for less predictable than a predictor knows them to be, so what it computes is too large. A
constant corrects that on average (fit: `docs/experiments/2026-11-22-stated-errors.md`).

What is left depends on what people do: who stands still is known better than reported, who runs or
turns worse. Innovations show it without labels: the distance of each keypoint from where the filter
predicts it, beside the expected distance. Both are added up for each person over the last seconds,
in metres, so that uncertain joints count as much as they do in a mean error; their quotient
corrects the constant (fit: `docs/experiments/2026-11-22-inflation-by-person.md`). Only keypoints
whose prediction is less certain than they are count: the others measure the detector.
"""

from __future__ import annotations

from e3pose.estimate.filter.learned_noise import MEDIAN, NORMAL

# Mean error over mean stated error. A predictor explains a part of the motion of the joints that it
# steers.
STEERED, ALONE = 0.75, 0.85

ACTUAL, EXPECTED = 0, 1  # layout: of `Belief.innovations`
# Innovations over expected ones where the reported error is the actual one. It is below 1 as
# uncertainty is mostly along one line of sight, and errors in two directions are longer.
USUAL = 0.9
PRIOR_M = 0.4  # of expected innovations that the constants count for: half a look at a person
MEMORY_S = 1.5  # of the sums: people who stand begin to walk
MOST = 2.0  # the learned factor, and its inverse
CLIP = 5.0  # times the expected innovation: a wild keypoint teaches no more
MOST_M = 0.3  # nor does a joint count for more that nothing is known of
LEAST_SHARE = 0.5  # of an innovation's variance that must be the prediction's
OWN_SHARE = MEDIAN / NORMAL  # of the variance that the filter takes for a keypoint's own
