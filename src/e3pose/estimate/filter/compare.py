"""Learning from the residuals of a slot: noise, bias, sides.

Before the update they are compared with where each joint is predicted: that tells how agile joints
are, and how far predictions are off (`covariance_inflation`). After it they are compared with where
all other evidence puts the joint: that tells how noisy cameras are (`learned_noise`) and by how
much views are off for seconds (`bias`).

Agility is how much more, or less, a person's joints move than a predictor expects. Where the
process noise of a joint is too large, every look moves it too far, and the next look of another
camera moves it back; where it is too small, the next look moves it on the same way. So the
logarithm of the factor on the noise follows the product of each innovation with the correction of
the look before, as its camera sees that. Looks of one camera are not compared: its errors repeat
themselves, and would look like motion. Figures: `lab/experiments/2026-11-23-agility.md`.
"""

from __future__ import annotations

import math

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.bias import inflation, learn_bias, learning_rate, left_over
from e3pose.estimate.filter.covariance_inflation import OWN_SHARE, add_innovation, fade_sums
from e3pose.estimate.filter.learned_noise import add_evidence, proved
from e3pose.estimate.filter.outliers import ROBUST
from e3pose.estimate.filter.projected import Beside, beside
from e3pose.estimate.filter.scratch import Constants, Detectors, Matches, Tracks, Views

# tuned: per keypoint | not recorded | agility
RATE = 0.1  # of one keypoint that confirms, or takes back, all of the correction before it
# tuned: logarithm | not recorded | agility
FURTHEST = 2.0  # the logarithm of the factor, either way
# tuned: s | not recorded | agility
LASTS_S = 3.0  # until what was learned is down to 1/e: people who stood begin to walk


@kernel
def fade_agility(agility: Floats, newest_s: float, dt: float) -> bool:
    """Forget a part of `agility` `(num_joints,)`; return whether the look before still tells.

    `newest_s` is the age of that look when the slot before was computed, `dt` the time since.
    """
    for joint in range(len(agility)):
        agility[joint] *= math.exp(-dt / LASTS_S)
    return newest_s + dt <= LASTS_S


@kernel
def confirm(
    found: Beside, variance: float, corrected_m: Floats, joint: int, agility: Floats
) -> None:
    """Let one keypoint teach `agility`: does it confirm the correction of the look before?

    `variance` is of the keypoint, px2; `corrected_m` `(3,)` the correction of its joint.
    """
    x, y, z = corrected_m[0], corrected_m[1], corrected_m[2]
    du, dv = found.du, found.dv
    alike = du * (found.ux * x + found.uy * y + found.uz * z)
    alike += dv * (found.vx * x + found.vy * y + found.vz * z)
    alike /= variance + found.variance_px2 + (du * du + dv * dv) * ROBUST
    learned = agility[joint] + RATE * min(max(alike, -1.0), 1.0)
    agility[joint] = min(max(learned, -FURTHEST), FURTHEST)


@kernel
def compare_predicted(
    track: int, dt: float, constants: Constants, views: Views, matches: Matches, tracks: Tracks
) -> None:
    """Compare the keypoints of a track that is about to be updated with its prediction."""
    state, covariance = tracks.state[track], tracks.covariance[track]
    agility, sums_m = tracks.agility[track], tracks.innovations[track]
    corrected_m, newest_s = tracks.corrected_m[track], tracks.last_seen_s[track].min()
    recent = fade_agility(agility, newest_s, dt)
    fade_sums(sums_m, dt)
    there, shown = proved(track, dt, views, matches, tracks), False
    drift_share = tracks.drift_share[track]
    for camera in range(len(views.counts)):
        person, since_s = matches.assigned[camera, track], tracks.last_seen_s[track, camera]
        if not (views.arrived[camera] and person >= 0):
            continue
        shown, row = True, views.starts[camera] + person
        factor = inflation(since_s + dt, constants.memory)
        own_share = OWN_SHARE * left_over(since_s + dt, constants.memory)
        bias_px, projection = tracks.bias_px[track, camera], constants.projections[camera]
        for joint in range(len(state)):
            found = beside(
                row, joint, state, covariance, projection, views.pixels, views.weights, bias_px
            )
            if not found.known:
                continue
            variance = views.variances[row, joint]
            if recent and since_s > newest_s:
                confirm(found, factor * variance, corrected_m[joint], joint, agility)
            if there and constants.is_core[joint]:
                add_innovation(found, own_share * variance, drift_share[joint], sums_m)
    if shown:
        for joint in range(len(state)):
            for axis in range(3):
                corrected_m[joint, axis] = state[joint, axis]  # before the update


@kernel
def compare_updated(
    track: int,
    dt: float,
    constants: Constants,
    views: Views,
    matches: Matches,
    tracks: Tracks,
    detectors: Detectors,
) -> None:
    """Compare each keypoint of an updated track with the estimate from all of them."""
    state, covariance = tracks.state[track], tracks.covariance[track]
    corrected_m, shown = tracks.corrected_m[track], False
    there = proved(track, dt, views, matches, tracks)
    for camera in range(len(views.counts)):
        person = matches.assigned[camera, track]
        if not (views.arrived[camera] and person >= 0):
            continue
        shown, row = True, views.starts[camera] + person
        since_s = tracks.last_seen_s[track, camera] + dt
        factor = inflation(since_s, constants.memory)
        own_share = left_over(since_s, constants.memory)
        rate = learning_rate(since_s, constants.memory)
        bias_px, projection = tracks.bias_px[track, camera], constants.projections[camera]
        for joint in range(len(state)):
            found = beside(
                row, joint, state, covariance, projection, views.pixels, views.weights, bias_px
            )
            if not found.known:
                continue
            variance, score = views.variances[row, joint], views.weights[row, joint]
            if there and constants.is_core[joint]:
                add_evidence(camera, found, score, variance, own_share, factor, detectors)
            learn_bias(found, rate, variance, bias_px[joint])
    if shown:
        for joint in range(len(state)):
            for axis in range(3):
                corrected_m[joint, axis] = state[joint, axis] - corrected_m[joint, axis]
