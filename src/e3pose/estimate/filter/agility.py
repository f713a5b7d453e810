"""Agility: how much more, or less, a person's joints move than a predictor expects.

Where the process noise of a joint is too large, every look moves it too far, and the next look of
another camera moves it back; where it is too small, the next look moves it on the same way. So the
logarithm of the factor on the noise follows the product of each innovation with the correction of
the look before, as its camera sees that. Looks of one camera are not compared: its errors repeat
themselves, and would look like motion. Figures: `lab/experiments/2026-11-23-agility.md`.
"""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.bias import inflation
from e3pose.estimate.filter.outliers import ROBUST
from e3pose.estimate.filter.projected import beside
from e3pose.estimate.filter.scratch import Constants, Matches, Tracks, Views

# tuned: per keypoint | not recorded | agility
RATE = 0.1  # of one keypoint that confirms, or takes back, all of the correction before it
# tuned: logarithm | not recorded | agility
FURTHEST = 2.0  # the logarithm of the factor, either way
# tuned: s | not recorded | agility
LASTS_S = 3.0  # until what was learned is down to 1/e: people who stood begin to walk


@kernel
def learn_agility(
    track: int, dt: float, constants: Constants, views: Views, matches: Matches, tracks: Tracks
) -> None:
    """Compare the keypoints of a track that is about to be updated with the correction before."""
    agility = tracks.agility[track]
    newest_s = np.inf
    for camera in range(len(views.counts)):
        newest_s = min(newest_s, tracks.last_seen_s[track, camera])
    for joint in range(len(agility)):
        agility[joint] *= math.exp(-dt / LASTS_S)
    if newest_s + dt > LASTS_S:
        return
    for camera in range(len(views.counts)):
        person = matches.assigned[camera, track]
        since_s = tracks.last_seen_s[track, camera]
        if views.arrived[camera] and person >= 0 and since_s > newest_s:
            _compare(
                views.starts[camera] + person,
                inflation(since_s + dt, constants.memory),
                tracks.state[track],
                tracks.covariance[track],
                tracks.corrected_m[track],
                constants.projections[camera],
                views,
                tracks.bias_px[track, camera],
                agility,
            )


@kernel
def _compare(
    row: int,
    factor: float,
    state: Floats,
    covariance: Floats,
    corrected_m: Floats,
    projection: Floats,
    views: Views,
    bias_px: Floats,
    agility: Floats,
) -> None:
    """Let one detection teach `agility`; `factor` is on its variances."""
    for joint in range(len(state)):
        known, du, dv, variance_px2, ux, uy, uz, vx, vy, vz = beside(
            row, joint, state, covariance, projection, views.pixels, views.weights, bias_px
        )
        if not known:
            continue
        variance = views.variances[row, joint] * factor + variance_px2
        x, y, z = corrected_m[joint, 0], corrected_m[joint, 1], corrected_m[joint, 2]
        alike = du * (ux * x + uy * y + uz * z) + dv * (vx * x + vy * y + vz * z)
        alike /= variance + (du * du + dv * dv) * ROBUST
        learned = agility[joint] + RATE * min(max(alike, -1.0), 1.0)
        agility[joint] = min(max(learned, -FURTHEST), FURTHEST)


@kernel
def note_place(track: int, tracks: Tracks) -> None:
    """Keep where a look finds each joint, until `note_correction`."""
    for joint in range(tracks.state.shape[1]):
        for axis in range(3):
            tracks.corrected_m[track, joint, axis] = tracks.state[track, joint, axis]


@kernel
def note_correction(track: int, tracks: Tracks) -> None:
    """Fill how far the look moved each joint from there."""
    for joint in range(tracks.state.shape[1]):
        for axis in range(3):
            before_m = tracks.corrected_m[track, joint, axis]
            tracks.corrected_m[track, joint, axis] = tracks.state[track, joint, axis] - before_m
