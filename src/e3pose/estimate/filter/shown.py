"""Publication of tracks: confirmed, still present, and consistent with their prediction."""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.base.kernel import kernel
from e3pose.base.kernel_arguments import Held
from e3pose.estimate.filter.blindness import PLAIN, chance, proof
from e3pose.estimate.filter.bones import Proportions
from e3pose.estimate.filter.covariance_inflation import learned_factor, spread_factor
from e3pose.estimate.filter.learned_noise import quietest
from e3pose.estimate.filter.posterior import Grades
from e3pose.estimate.filter.proportions import keep_all
from e3pose.estimate.filter.repeated_errors import (
    MOST_LASTING_M,
    MOST_M,
    find_repeated,
    weigh_biases,
    weigh_views,
)
from e3pose.estimate.filter.scratch import Constants
from e3pose.estimate.filter.state import Belief, Known, Model
from e3pose.model.dynamics import SIZE as DYNAMICS
from e3pose.model.dynamics import find_dynamics
from e3pose.model.people import People

HALF_SCORE_M = 0.1  # definition: standard deviation of a joint at which its score is a half
LEAST_SCORE = 1e-3  # definition: a joint that is known at all is not missing
# tuned: m | simulated, seeds 701 to 706: fewer misses with one camera than 20 cm, fewer false
#   people than 45 cm, lab/experiments/2026-11-23-one-camera.md | shown spread
SHOWN_SPREAD_M = 0.3  # who has no joint that is more certain is not shown
# tuned: 1/s | first guess | leaving at all
LEAVES_HZ = 0.03  # of somebody who is there: once in half a minute


def shown(belief: Belief, model: Model) -> Flags:
    """Return `(num_tracks,)`: published tracks; the others are kept for re-association."""
    flags = np.empty(len(belief), dtype=bool)
    who_is_shown(
        int(model.tree.order[0]),
        model.corner_m,
        belief.state,
        belief.covariance,
        belief.confirmed,
        belief.last_seen_s,
        belief.missed,
        belief.detection_map,
        flags,
    )
    return flags


def people_of(belief: Belief, model: Model) -> People:
    """Return the published people by the tracks' ids, as sure as the belief is of them.

    Their `sigma_m` is left unknown.
    """
    (rows,) = shown(belief, model).nonzero()
    shape = len(rows), len(model.skeleton)
    joints_m, covariance_m2 = np.empty((*shape, 3)), np.empty((*shape, 3, 3))
    measured, scores = np.empty(shape, dtype=bool), np.empty(shape)
    dynamics = np.empty((*shape, DYNAMICS))
    show(
        model.proportions,
        rows,
        belief.unmeasured_s,
        belief.state,
        belief.covariance,
        belief.bones_m,
        belief.bone_counts,
        joints_m,
        covariance_m2,
        measured,
        scores,
        dynamics,
    )
    return People.unchecked(
        joints_m,
        scores,
        track_ids=belief.track_ids[rows],
        measured=measured,
        full_covariance_m2=covariance_m2,
        dynamics=dynamics,
    )


@kernel
def who_is_shown(
    root: int,
    corner_m: Floats,
    state: Floats,
    covariance: Floats,
    confirmed: Flags,
    last_seen_s: Floats,
    missed: Floats,
    detection_map: Floats,
    shown: Flags,
) -> None:
    """Fill `shown` `(num_tracks,)`; other arguments as in `Belief`."""
    for track in range(len(shown)):
        shown[track] = confirmed[track]
        if shown[track]:
            least = np.inf
            for joint in range(state.shape[1]):
                block = covariance[track, joint]
                least = min(least, block[0, 0] + block[1, 1] + block[2, 2])
            shown[track] = math.sqrt(least) < SHOWN_SPREAD_M
        if shown[track]:
            odds = left_odds(
                state[track, root],
                last_seen_s[track],
                missed[track],
                detection_map,
                corner_m,
            )
            shown[track] = odds < 1.0  # who has more likely left than not is followed only


@kernel
def left_odds(
    root: Floats,
    last_seen_s: Floats,
    missed: Floats,
    detection_map: Floats,
    corner_m: Floats,
) -> float:
    """Return the odds that a person has left since a view last showed them.

    With the rate h at which people leave, t seconds without a measurement and looks since then
    that show people there with probabilities p, they are h t / prod (1 - p).

    Args:
        root: `(6,)` state of the root of the body.
        last_seen_s: `(num_cameras,)`.
        missed: `(num_cameras,)`.
        detection_map: as in `Belief`.
        corner_m: of its cells.
    """
    unseen_s = np.inf
    for camera in range(len(last_seen_s)):
        unseen_s = min(unseen_s, last_seen_s[camera])
    if not unseen_s > 0:
        return 0.0
    misses = 0.0  # as many as these in plain sight
    for camera in range(len(missed)):
        misses += missed[camera] * proof(detection_map[camera], root, corner_m)
    return float(LEAVES_HZ * unseen_s * (1 - PLAIN) ** -misses)


@kernel
def likely_shown(detection_map: Floats, root_m: Floats, corner_m: Floats) -> float:
    """Return the probability that a camera detects a person at a place, see `Outlook.shows`."""
    return float(min(chance(detection_map, root_m, corner_m) / PLAIN, 1.0))


@kernel
def show(
    body: Proportions,
    rows: Integers,
    unmeasured_s: Floats,
    state: Floats,
    covariance: Floats,
    bones_m: Floats,
    bone_counts: Floats,
    joints_m: Floats,
    covariance_m2: Floats,
    measured: Flags,
    scores: Floats,
    dynamics: Floats,
) -> None:
    """Fill the arrays of `People` with the tracks at `rows`.

    Arguments up to `bone_counts` are of `Belief`; joints that were never measured are missing.
    """
    for index in range(len(rows)):
        track = rows[index]
        for joint in range(state.shape[1]):
            unmeasured = unmeasured_s[track, joint]
            ever_measured = math.isfinite(unmeasured)
            measured[index, joint] = unmeasured == 0.0
            for a in range(3):
                joints_m[index, joint, a] = state[track, joint, a] if ever_measured else np.nan
                for b in range(3):
                    block = covariance[track, joint, a, b]
                    covariance_m2[index, joint, a, b] = block if ever_measured else np.nan
    keep_all(body, bones_m[rows], bone_counts[rows], joints_m, covariance_m2, measured)
    for index in range(len(rows)):
        track = rows[index]
        for joint in range(state.shape[1]):
            block = covariance_m2[index, joint]
            variance = (block[0, 0] + block[1, 1] + block[2, 2]) / 3
            score = max(1.0 / (1.0 + variance / HALF_SCORE_M**2), LEAST_SCORE)
            scores[index, joint] = score if math.isfinite(variance) else 0.0
            find_dynamics(state[track, joint], covariance[track, joint], dynamics[index, joint])
            if not math.isfinite(variance):
                dynamics[index, joint] = np.nan


@kernel
def grade(
    held: Held[Constants],
    rows: Integers,
    known: Known,
    covariance_m2: Floats,
    grades: Grades,
) -> None:
    """Fill the published covariances of people.

    Args:
        held: constants of the rig, the skeleton and the detector.
        rows: `(num_persons,)` of their tracks.
        known: what the belief knows of its tracks.
        covariance_m2: `(num_persons, num_joints, 3, 3)` of `people_of`.
        grades: filled; `bias_share` adds up.
    """
    constants = held.values
    sigma_px, weights = np.empty(len(constants.scales)), np.empty(len(constants.scales))
    lasting = np.empty(len(constants.scales))
    quietest(known.noise, constants, sigma_px)
    for index in range(len(rows)):
        track = rows[index]
        seen_s, delivered = known.last_seen_s[track], known.delivered[track]
        weigh_views(seen_s, delivered, sigma_px, constants.memory, weights)
        of_person = learned_factor(known.innovations[track])
        for joint in range(covariance_m2.shape[1]):
            factor = spread_factor(known.drift_share[track, joint], of_person)
            block = covariance_m2[index, joint]
            grades.inflation[index, joint] = factor
            repeated = grades.repeated_m2[index, joint]
            place = known.state[track, joint]
            find_repeated(place, weights, constants.projections, MOST_M, repeated)
            biases_px, share = known.bias_px[track, :, joint], grades.bias_share
            weigh_biases(biases_px, seen_s, sigma_px, constants.memory, weights, lasting, share)
            lasting_m2 = grades.lasting_m2[index, joint]
            find_repeated(place, lasting, constants.projections, MOST_LASTING_M, lasting_m2)
            for a in range(3):
                for b in range(3):
                    grades.stated_m2[index, joint, a, b] = block[a, b] * factor**2 + repeated[a, b]


@kernel
def grow(excess: float, covariance_m2: Floats, grades: Grades, sigma_m: Floats) -> float:
    """Grow the stated errors, as far as errors last longer than the noise file says.

    What is reported besides the belief's own covariance is expected of slots to come, too.

    Args:
        excess: as of `lasting.grown_m2`.
        covariance_m2: as of `grade`.
        grades: filled by `grade`; `stated_m2` is changed.
        sigma_m: `(num_persons, num_joints)` filled with the stated deviation along an axis.

    Returns:
        All standard deviations as stated over those of `covariance_m2`; 0 where there are none.
    """
    own_m = stated_m = 0.0
    for person in range(sigma_m.shape[0]):
        for joint in range(sigma_m.shape[1]):
            own_m2 = stated_m2 = 0.0
            for a in range(3):
                for b in range(3):
                    repeated_m2 = grades.repeated_m2[person, joint, a, b]
                    more_m2 = grades.lasting_m2[person, joint, a, b] - repeated_m2
                    grades.stated_m2[person, joint, a, b] += excess * more_m2
                own_m2 += covariance_m2[person, joint, a, a]
                stated_m2 += grades.stated_m2[person, joint, a, a]
            sigma_m[person, joint] = 0.0 if stated_m2 < 0.0 else math.sqrt(stated_m2 / 3)
            if math.isfinite(own_m2) and math.isfinite(stated_m2):
                own_m += math.sqrt(own_m2)
                stated_m += math.sqrt(stated_m2)
    return stated_m / own_m if own_m > 0.0 else 0.0
