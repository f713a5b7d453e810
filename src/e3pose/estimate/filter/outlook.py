"""Outlook: people predicted for a future slot, with covariances."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.base.kernel import kernel
from e3pose.base.kernel_arguments import Held
from e3pose.estimate.base import Expected, Outlook
from e3pose.estimate.filter.allocation import held_constants
from e3pose.estimate.filter.covariance_inflation import learned_factor, spread_factor
from e3pose.estimate.filter.failed_pairs import count_newest
from e3pose.estimate.filter.lasting import USUAL
from e3pose.estimate.filter.learned_noise import expect_alike
from e3pose.estimate.filter.motion import move
from e3pose.estimate.filter.scratch import Constants
from e3pose.estimate.filter.shown import likely_shown
from e3pose.estimate.filter.state import Belief, Known, Model, known_of


def outlook(
    model: Model,
    belief: Belief,
    ahead_s: float,
    track_ids: Integers | None = None,
    factor: float = 1.0,
    bias_share: float = USUAL,
) -> Outlook:
    """Return the prediction `ahead_s` seconds after the belief's slot, without new views.

    Args:
        model: of the filter.
        belief: about everybody.
        ahead_s: 0 or more.
        track_ids: `(num_tracks,)` identities; the belief's own ids by default.
        factor: on standard deviations (`stated_factor`).
        bias_share: of the last seconds, as in `Outlook`.
    """
    drift, lasts_s = model.alone
    num_cameras, leftovers = len(model.rig), belief.leftovers
    people, pairs = (len(belief), len(model.core)), belief.last_seen_s.shape
    expected = Expected(
        track_ids=belief.track_ids if track_ids is None else track_ids,
        confirmed=belief.confirmed,
        joints_m=np.empty((*people, 3)),
        covariance=np.empty((*people, 6, 6)),
        drift_m2ps3=np.empty(people),
        velocity_lasts_s=lasts_s[model.core],
        delivered=np.empty(pairs),
        shows=np.empty(pairs),
        last_seen_s=belief.last_seen_s,
        sigma_px=np.empty(num_cameras),
    )
    expect(held_constants(model), ahead_s, factor, drift, known_of(belief), expected)
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
        expected=expected,
        has_memory=True,
        detection_map=belief.detection_map,
        memory=model.noise.memory,
        bias_share=bias_share,
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
    known: Known,
    expected: Expected,
) -> None:
    """Fill the people and keypoint noise of an `Outlook`.

    Args:
        held: constants of the rig, the skeleton and the detector.
        ahead_s: seconds after the belief's slot, if nothing is seen.
        factor: on standard deviations (`covariance_inflation`).
        drift_m2ps3: `(num_joints,)` of `Model.alone`.
        known: of the belief.
        expected: its predicted arrays are filled.
    """
    constants, state, sigma_px = held.values, known.state, expected.sigma_px
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
        for place, joint in enumerate(constants.core):
            drift = drift_m2ps3[joint] * known.drift_share[track, joint] * factor**2
            expected.drift_m2ps3[track, place] = drift
            for axis in range(3):
                expected.joints_m[track, place, axis] = moved[joint, axis]
            for row in range(6):
                for column in range(6):
                    block = known.covariance[track, joint, row, column]
                    expected.covariance[track, place, row, column] = block * factor**2
        root = moved[constants.order[0]]
        for camera in range(len(known.detection_map)):
            shown = likely_shown(known.detection_map[camera], root, constants.corner_m)
            expected.shows[track, camera] = shown
    worth = np.empty(len(sigma_px))
    expect_alike(known.noise, constants, sigma_px, worth)
    for camera in range(len(sigma_px)):
        sigma_px[camera] *= factor
        for track in range(len(state)):
            expected.delivered[track, camera] = worth[camera] * known.delivered[track, camera]


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
