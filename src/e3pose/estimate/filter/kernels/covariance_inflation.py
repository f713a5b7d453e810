"""Innovation statistics: the loops of `filter.covariance_inflation`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.filter.covariance_inflation import (
    ACTUAL,
    ALONE,
    CLIP,
    EXPECTED,
    LEAST_SHARE,
    MEMORY_S,
    MOST,
    MOST_M,
    OWN_SHARE,
    PRIOR_M,
    STEERED,
    USUAL,
)
from e3pose.estimate.filter.kernels.bias import left_over
from e3pose.estimate.filter.kernels.learned_noise import proved
from e3pose.estimate.filter.kernels.projected import beside
from e3pose.estimate.filter.kernels.scratch import Matches, Site, Tracks, Views
from e3pose.runtime.kernel import kernel

Floats = NDArray[np.float64]

MEAN = math.pi / 2  # definition: squared mean of a distance over the variance of either coordinate


@kernel
def compare_predicted(
    track: int, dt: float, site: Site, views: Views, matches: Matches, tracks: Tracks
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
                OWN_SHARE * left_over(since_s, site.memory),
                tracks.state[track],
                tracks.covariance[track],
                tracks.drift_share[track],
                site.projections[camera],
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
