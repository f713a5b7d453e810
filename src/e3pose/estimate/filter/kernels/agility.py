"""Agility: the loops of `filter.agility`, for one track."""

from __future__ import annotations

import math

import numpy as np

from e3pose.estimate.filter.agility import FURTHEST, LASTS_S, RATE, STALE_S
from e3pose.estimate.filter.kernels.bias import inflation
from e3pose.estimate.filter.kernels.projected import projected_variance_px2, shown_at
from e3pose.estimate.filter.kernels.scratch import Floats, Matches, Site, Tracks, Views
from e3pose.estimate.filter.kernels.update import ROBUST
from e3pose.estimate.filter.state import MIN_SCORE
from e3pose.geometry.projection import MIN_DEPTH_M
from e3pose.runtime.kernel import kernel


@kernel
def learn_agility(
    track: int, dt: float, site: Site, views: Views, matches: Matches, tracks: Tracks
) -> None:
    """Compare the keypoints of a track that is about to be updated with the correction before."""
    agility = tracks.agility[track]
    newest_s = np.inf
    for camera in range(len(views.counts)):
        newest_s = min(newest_s, tracks.last_seen_s[track, camera])
    for joint in range(len(agility)):
        agility[joint] *= math.exp(-dt / LASTS_S)
    if newest_s + dt > STALE_S:
        return
    for camera in range(len(views.counts)):
        person = matches.assigned[camera, track]
        since_s = tracks.last_seen_s[track, camera]
        if views.arrived[camera] and person >= 0 and since_s > newest_s:
            _compare(
                views.starts[camera] + person,
                inflation(since_s + dt, site.memory),
                tracks.state[track],
                tracks.covariance[track],
                tracks.corrected_m[track],
                site.projections[camera],
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
        if not views.weights[row, joint] > MIN_SCORE:
            continue
        x, y, z = state[joint, 0], state[joint, 1], state[joint, 2]
        depth, u, v, ux, uy, uz, vx, vy, vz = shown_at(projection, x, y, z)
        if not depth > MIN_DEPTH_M:
            continue
        variance = views.variances[row, joint] * factor
        variance += projected_variance_px2(covariance[joint], ux, uy, uz, vx, vy, vz)
        du = views.pixels[row, joint, 0] - bias_px[joint, 0] - u
        dv = views.pixels[row, joint, 1] - bias_px[joint, 1] - v
        x, y, z = corrected_m[joint, 0], corrected_m[joint, 1], corrected_m[joint, 2]
        alike = du * (ux * x + uy * y + uz * z) + dv * (vx * x + vy * y + vz * z)
        alike /= variance + (du * du + dv * dv) * ROBUST
        learned = agility[joint] + RATE * min(max(alike, -1.0), 1.0)
        agility[joint] = min(max(learned, -FURTHEST), FURTHEST)


@kernel
def note_correction(track: int, sign: float, tracks: Tracks) -> None:
    """Fill how far a look moves each joint: called with -1 before the update and 1 after it."""
    for joint in range(tracks.state.shape[1]):
        for axis in range(3):
            before_m = tracks.corrected_m[track, joint, axis] if sign > 0.0 else 0.0
            tracks.corrected_m[track, joint, axis] = (
                before_m + sign * tracks.state[track, joint, axis]
            )
