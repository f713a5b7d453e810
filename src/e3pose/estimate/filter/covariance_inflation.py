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
from e3pose.estimate.filter.bias import left_over
from e3pose.estimate.filter.learned_noise import MEDIAN, NORMAL, proved
from e3pose.estimate.filter.projected import beside
from e3pose.estimate.filter.scratch import Constants, Matches, Tracks, Views

# Mean error over mean stated error. A predictor explains a part of the motion of the joints that it
# steers.
# tuned: factor, factor | lab/experiments/2026-11-22-stated-errors.md | not measured
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
#   | not measured
CLIP = 5.0  # times the expected innovation: a wild keypoint teaches no more
# tuned: m | not recorded | not measured
MOST_M = 0.3  # nor does a joint count for more that nothing is known of
# tuned: share | simulated: 0.35 or 0.8 are no better,
#   lab/experiments/2026-11-22-inflation-by-person.md | not measured
LEAST_SHARE = 0.5  # of an innovation's variance that must be the prediction's
OWN_SHARE = MEDIAN / NORMAL  # of the variance that the filter takes for a keypoint's own
MEAN = math.pi / 2  # definition: squared mean of a distance over the variance of either coordinate


@kernel
def compare_predicted(
    track: int, dt: float, constants: Constants, views: Views, matches: Matches, tracks: Tracks
) -> None:
    """Compare the keypoints of a track that is about to be updated with its prediction.

    Advances its row of `Belief.innovations`.
    """
    sums_m = tracks.innovations[track]
    left = math.exp(-dt / MEMORY_S)
    sums_m[ACTUAL] *= left
    sums_m[EXPECTED] *= left
    if not proved(track, dt, views, matches, tracks):
        return
    for camera in range(len(views.counts)):
        person = matches.assigned[camera, track]
        if views.arrived[camera] and person >= 0:
            since_s = tracks.last_seen_s[track, camera] + dt
            _compare(
                views.starts[camera] + person,
                OWN_SHARE * left_over(since_s, constants.memory),
                tracks.state[track],
                tracks.covariance[track],
                tracks.drift_share[track],
                constants.projections[camera],
                views,
                tracks.bias_px[track, camera],
                sums_m,
            )


@kernel
def _compare(
    row: int,
    own_share: float,
    state: Floats,
    covariance: Floats,
    drift_share: Floats,
    projection: Floats,
    views: Views,
    bias_px: Floats,
    sums_m: Floats,
) -> None:
    """Add the innovations of one detection; `own_share` is on its variances."""
    for joint in range(len(state)):
        known, du, dv, variance_px2, ux, uy, uz, vx, vy, vz = beside(
            row, joint, state, covariance, projection, views.pixels, views.weights, bias_px
        )
        if not known:
            continue
        factor = spread_factor(drift_share[joint], 1.0)
        variance_px2 *= factor**2
        total = variance_px2 + own_share * views.variances[row, joint]
        if variance_px2 > LEAST_SHARE * total:
            expected_px = math.sqrt(MEAN * total)
            off = math.sqrt(du * du + dv * dv) / expected_px
            squares = ux * ux + uy * uy + uz * uz + vx * vx + vy * vy + vz * vz
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
