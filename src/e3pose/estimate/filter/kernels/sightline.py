"""People at a wrong distance from the one camera that follows them.

A camera shows nothing of the distance of whom it follows alone. Where that is wrong by more than
the filter believes, the next camera's detection lies beyond the association limit: nobody explains
it, and the distance stays wrong. So such a detection is compared with the lines of sight of the
following camera: if one distance explains all of it, the person is moved along them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.filter.kernels.associate import BIAS_PX, JOINT_LIMIT, fit_of
from e3pose.estimate.filter.kernels.projected import shown_at
from e3pose.estimate.filter.kernels.scratch import Matches, Site, Tracks, Views
from e3pose.estimate.filter.state import MIN_SCORE
from e3pose.geometry.projection import MIN_DEPTH_M
from e3pose.runtime.kernel import kernel

Floats = NDArray[np.float64]

LONE_S = 0.2  # since a second camera showed a person
MOST_M = 0.8  # that a person is moved
FIT_LIMIT = 2.2  # mean distance in standard deviations that one distance must leave
MIN_JOINTS = 5
WIDE = 0.5  # of the way, standard deviation along the line of sight after it


@kernel
def correct_distances(
    num_tracks: int, site: Site, views: Views, tracks: Tracks, matches: Matches
) -> None:
    """Move people whom one camera follows to where another one shows them, and assign them there.

    Constants and figures: `docs/experiments/2026-11-22-inflation-by-person.md`.
    """
    for track in range(num_tracks):
        if not tracks.confirmed[track]:
            continue
        alone, second_s = follower(tracks.last_seen_s[track])
        if alone < 0 or second_s < LONE_S:
            continue
        centre = site.centers_m[alone]
        for camera in range(len(views.counts)):
            if camera == alone or not views.arrived[camera]:
                continue
            if matches.assigned[camera, track] >= 0:
                break
            best, best_cost, best_m = -1, FIT_LIMIT, 0.0
            for person in range(views.counts[camera]):
                row = views.starts[camera] + person
                if not views.free[row]:
                    continue
                moved_m, cost = _fit(
                    row,
                    site.projections[camera],
                    (BIAS_PX * site.scales[camera]) ** 2,
                    centre,
                    tracks.state[track],
                    views,
                )
                if cost < best_cost and abs(moved_m) < MOST_M:
                    best, best_cost, best_m = person, cost, moved_m
            if best < 0:
                continue
            _move(centre, best_m, tracks.state[track], tracks.covariance[track])
            matches.assigned[camera, track] = best
            matches.fits[camera, track] = fit_of(best_cost)
            views.free[views.starts[camera] + best] = False
            break


@kernel
def follower(last_seen_s: Floats) -> tuple[int, float]:
    """Return the camera that showed a person last, and the seconds since another one did."""
    first, first_s, second_s = -1, np.inf, np.inf
    for camera in range(len(last_seen_s)):
        if last_seen_s[camera] < first_s:
            first, second_s, first_s = camera, first_s, last_seen_s[camera]
        else:
            second_s = min(second_s, last_seen_s[camera])
    return first, second_s


@kernel
def _fit(
    row: int, projection: Floats, bias: float, centre: Floats, state: Floats, views: Views
) -> tuple[float, float]:
    """Return by how many metres joints must move from a place to fit a detection, and the cost.

    Least squares over the joints shown; the cost is that of `associate`, without the track's own
    covariance. Infinite where too few are shown.
    """
    shown, along, across = 0, 0.0, 0.0
    for joint in range(len(state)):
        seen, du, dv, du_m, dv_m, variance = _beside(
            row, joint, projection, bias, centre, state, views
        )
        if seen:
            shown += 1
            along += (du * du_m + dv * dv_m) / variance
            across += (du_m * du_m + dv_m * dv_m) / variance
    if shown < MIN_JOINTS or not across > 0.0:
        return 0.0, np.inf
    moved_m, total, weighted = along / across, 0.0, 0.0
    for joint in range(len(state)):
        seen, du, dv, du_m, dv_m, variance = _beside(
            row, joint, projection, bias, centre, state, views
        )
        if seen:
            du, dv = du - moved_m * du_m, dv - moved_m * dv_m
            weight = views.weights[row, joint]
            total += weight
            weighted += weight * min(math.sqrt((du * du + dv * dv) / variance), JOINT_LIMIT)
    return moved_m, weighted / max(total, 1e-9)


@kernel
def _beside(
    row: int,
    joint: int,
    projection: Floats,
    bias: float,
    centre: Floats,
    state: Floats,
    views: Views,
) -> tuple[bool, float, float, float, float, float]:
    """Return whether a joint is shown, and how far beside the state.

    Returns:
        `seen, du, dv, du_m, dv_m, variance`: pixels from the state to the keypoint, pixels per
        metre along the line from `centre`, and px^2 of either coordinate.
    """
    if not views.weights[row, joint] > MIN_SCORE:
        return False, 0.0, 0.0, 0.0, 0.0, 1.0
    x, y, z = state[joint, 0], state[joint, 1], state[joint, 2]
    depth, u, v, ux, uy, uz, vx, vy, vz = shown_at(projection, x, y, z)
    if not depth > MIN_DEPTH_M:
        return False, 0.0, 0.0, 0.0, 0.0, 1.0
    lx, ly, lz = x - centre[0], y - centre[1], z - centre[2]
    far_m = math.sqrt(lx * lx + ly * ly + lz * lz)
    return (
        True,
        views.pixels[row, joint, 0] - u,
        views.pixels[row, joint, 1] - v,
        (ux * lx + uy * ly + uz * lz) / far_m,
        (vx * lx + vy * ly + vz * lz) / far_m,
        views.variances[row, joint] + bias,
    )


@kernel
def _move(centre: Floats, moved_m: float, state: Floats, covariance: Floats) -> None:
    """Move a person from a camera, and widen the covariance along its lines of sight."""
    line = np.empty(3)
    for joint in range(len(state)):
        far_m = 0.0
        for axis in range(3):
            line[axis] = state[joint, axis] - centre[axis]
            far_m += line[axis] * line[axis]
        far_m = math.sqrt(far_m)
        for axis in range(3):
            line[axis] /= far_m
            state[joint, axis] += moved_m * line[axis]
        for row in range(3):
            for column in range(3):
                covariance[joint, row, column] += (WIDE * moved_m) ** 2 * line[row] * line[column]
