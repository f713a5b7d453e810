"""Outlook: people predicted for a future slot, with covariances."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.base.held import Held
from e3pose.base.kernel import kernel
from e3pose.estimate.base import Outlook
from e3pose.estimate.filter.allocation import held_constants
from e3pose.estimate.filter.covariance_inflation import learned_factor, spread_factor
from e3pose.estimate.filter.failed_pairs import count_newest
from e3pose.estimate.filter.learned_noise import quietest
from e3pose.estimate.filter.motion import move
from e3pose.estimate.filter.scratch import Constants
from e3pose.estimate.filter.shown import find_needed, likely_shown
from e3pose.estimate.filter.state import Belief, Model


def outlook(
    model: Model,
    belief: Belief,
    ahead_s: float,
    track_ids: Integers | None = None,
    factor: float = 1.0,
) -> Outlook:
    """Return the prediction `ahead_s` seconds after the belief's slot, without new views.

    Args:
        model: of the filter.
        belief: about everybody.
        ahead_s: 0 or more.
        track_ids: `(num_tracks,)` identities; the belief's own ids by default.
        factor: on standard deviations (`stated_factor`).
    """
    drift, lasts_s = model.alone
    num_cameras, leftovers = len(model.rig), belief.leftovers
    people, pairs = belief.drift_share.shape, belief.last_seen_s.shape
    joints_m, covariance = np.empty((*people, 3)), np.empty((*people, 6, 6))
    drift_m2ps3, shows = np.empty(people), np.empty(pairs)
    needed, sigma_px = np.empty(pairs, dtype=bool), np.empty(num_cameras)
    expect(
        held_constants(model),
        ahead_s,
        factor,
        drift,
        belief.state,
        belief.covariance,
        belief.drift_share,
        belief.last_seen_s,
        belief.seen_by,
        belief.confirmed,
        belief.detection_map,
        belief.noise,
        joints_m,
        covariance,
        drift_m2ps3,
        shows,
        needed,
        sigma_px,
    )
    unexplained, times_s = np.empty(num_cameras, dtype=np.int64), np.empty(num_cameras)
    count_newest(
        leftovers.cameras,
        leftovers.times_s,
        leftovers.keypoints_px,
        leftovers.scores,
        np.ascontiguousarray(model.rig.image_sizes),
        belief.failed_pairs,
        unexplained,
        times_s,
    )
    return Outlook(
        track_ids=belief.track_ids if track_ids is None else track_ids,
        confirmed=belief.confirmed,
        joints_m=joints_m,
        covariance=covariance,
        drift_m2ps3=drift_m2ps3,
        velocity_lasts_s=lasts_s,
        has_memory=True,
        delivered=belief.delivered,
        shows=shows,
        last_seen_s=belief.last_seen_s,
        needed=needed,
        sigma_px=sigma_px,
        memory=model.noise.memory,
        unexplained=unexplained,
        unexplained_s=belief.time_s - times_s,
        wait_s=model.wait_s,
    )


def stated_factor(belief: Belief) -> float:
    """Return one factor that makes the standard deviations of all published people consistent.

    One factor for everybody changes what is expected, but not which cameras tell most.
    """
    return mean_factor(belief.drift_share, belief.innovations, belief.confirmed)


@kernel
def expect(
    held: Held[Constants],
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
        held: constants of the rig, the skeleton and the detector.
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
    constants = held.values
    moved = np.empty(state.shape[1:])
    for track in range(len(state)):
        move(
            ahead_s,
            constants.order,
            constants.parents,
            constants.lasts_s,
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
        root = joints_m[track, constants.order[0]]
        for camera in range(len(detection_map)):
            shows[track, camera] = likely_shown(detection_map[camera], root, constants.corner_m)
    find_needed(state, last_seen_s, confirmed, seen_by, ahead_s, needed)
    quietest(
        noise,
        constants.noise_weight,
        constants.scales,
        constants.noise_scores,
        constants.noise_px,
        sigma_px,
    )
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
