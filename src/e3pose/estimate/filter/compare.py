"""Learning from the residuals of a slot: noise, bias, sides.

Before the update they are compared with where each joint is predicted: that tells how agile joints
are (`agility`) and how far predictions are off (`covariance_inflation`). After it they are compared
with where all other evidence puts the joint: that tells how noisy cameras are (`learned_noise`) and
by how much views are off for seconds (`bias`).
"""

from __future__ import annotations

from e3pose.base.kernel import kernel
from e3pose.estimate.filter.agility import confirm, fade_agility
from e3pose.estimate.filter.bias import inflation, learn_bias, learning_rate, left_over
from e3pose.estimate.filter.covariance_inflation import OWN_SHARE, add_innovation, fade_sums
from e3pose.estimate.filter.learned_noise import add_evidence, proved
from e3pose.estimate.filter.projected import beside
from e3pose.estimate.filter.scratch import Constants, Detectors, Matches, Tracks, Views


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
