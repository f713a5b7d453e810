"""Predictions for a future slot (`filter.outlook`): the loops over people."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.filter.kernels.covariance_inflation import learned_factor, spread_factor
from e3pose.estimate.filter.kernels.learned_noise import quietest
from e3pose.estimate.filter.kernels.motion import move
from e3pose.estimate.filter.kernels.scratch import Site
from e3pose.estimate.filter.kernels.shown import find_needed, likely_shown
from e3pose.runtime.held import Held
from e3pose.runtime.kernel import kernel

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


@kernel
def expect(
    constants: Held[Site],
    ahead_s: float,
    factor: float,
    drift_m2ps3: Floats,
    state: Floats,
    covariance: Floats,
    drift_share: Floats,
    last_seen_s: Floats,
    seen_by: Flags,
    confirmed: Flags,
    detection_map: Floats,
    noise: Floats,
    joints_m: Floats,
    stated: Floats,
    drift: Floats,
    shows: Floats,
    needed: Flags,
    sigma_px: Floats,
) -> None:
    """Fill the people and keypoint noise of an `Outlook`.

    Args:
        constants: of the rig, the skeleton and the detector.
        ahead_s: seconds after the belief's slot, if nothing is seen.
        factor: on standard deviations (`covariance_inflation`).
        drift_m2ps3: `(num_joints,)` of `Model.alone`.
        state: as in `Belief`, like all up to `noise`.
        covariance: `(num_tracks, num_joints, 6, 6)`.
        drift_share: `(num_tracks, num_joints)`.
        last_seen_s: `(num_tracks, num_cameras)`.
        seen_by: `(num_tracks, num_cameras)`.
        confirmed: `(num_tracks,)`.
        detection_map: `(num_cameras, NUM_CELLS, NUM_CELLS, 2)`.
        noise: `(num_cameras + 1, 2)`.
        joints_m: as in `Outlook`, like all that follow; filled.
        stated: `(num_tracks, num_joints, 6, 6)`, the covariance of the `Outlook`.
        drift: `(num_tracks, num_joints)`.
        shows: `(num_tracks, num_cameras)`.
        needed: `(num_tracks, num_cameras)`.
        sigma_px: `(num_cameras,)`.
    """
    site = constants.values
    moved = np.empty(state.shape[1:])
    for track in range(len(state)):
        move(
            ahead_s,
            site.order,
            site.parents,
            site.lasts_s,
            state[track],
            moved,
        )
        for joint in range(state.shape[1]):
            drift[track, joint] = drift_m2ps3[joint] * drift_share[track, joint] * factor**2
            for axis in range(3):
                joints_m[track, joint, axis] = moved[joint, axis]
            for row in range(6):
                for column in range(6):
                    block = covariance[track, joint, row, column]
                    stated[track, joint, row, column] = block * factor**2
        root = joints_m[track, site.order[0]]
        for camera in range(len(detection_map)):
            shows[track, camera] = likely_shown(detection_map[camera], root, site.corner_m)
    find_needed(state, last_seen_s, confirmed, seen_by, ahead_s, needed)
    quietest(noise, site.noise_weight, site.scales, site.noise_scores, site.noise_px, sigma_px)
    for camera in range(len(sigma_px)):
        sigma_px[camera] *= factor


@kernel
def mean_factor(drift_share: Floats, innovations: Floats, confirmed: Flags) -> float:
    """Return the mean factor on the standard deviations of confirmed tracks; 1 without any.

    Arguments are of `Belief`.
    """
    total, count = 0.0, 0
    for track in range(len(confirmed)):
        if confirmed[track]:
            of_person = learned_factor(innovations[track])
            for joint in range(drift_share.shape[1]):
                total += spread_factor(drift_share[track, joint], of_person)
                count += 1
    return total / count if count else 1.0
