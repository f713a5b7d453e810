"""Data association: tracks and the detections of one view, by projected distance."""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.existence import INSIDE_JOINTS
from e3pose.estimate.filter.projected import (
    IN_FRONT,
    SPREAD,
    USED_SCORE,
    U,
    V,
    projected_variance_px2,
)
from e3pose.estimate.filter.scratch import Constants, Matches, Offers, Views
from e3pose.estimate.filter.sides import SIDE_PX, exchange, exchanged_limbs
from e3pose.estimate.per_slot.assign import assign
from e3pose.model.projection import MIN_DEPTH_M, shown_at

# tuned: px | simulated: 8, 14, 20 within 1 %; on Shelf without labels identities at 1.15 cameras 7
#   to 10, 5 to 8, 5 to 7 | half and twice
BIAS_PX = 14.0  # of a view's whole detection, on top of its keypoints' noise: errors are correlated
# tuned: joints | first guess | half and twice
MIN_JOINTS = 3
# tuned: standard deviations | first guess | half and twice
COST_LIMIT = 2.8  # mean distance in standard deviations beyond which it is somebody else
COST_USUAL = 1.0  # definition: of a standard deviation; a detection that is right is nearer
JOINT_LIMIT = 2 * COST_LIMIT  # definition: what one wild joint may say at most
NEVER = 1e3  # numerics


@kernel
def associate(
    camera: int,
    num_tracks: int,
    constants: Constants,
    views: Views,
    confirmed: Flags,
    state: Floats,
    covariance: Floats,
    matches: Matches,
    offers: Offers,
) -> None:
    """Fill one camera's rows of `matches` and `views.free`, for an arrived view.

    Where a detection that is assigned has exchanged left and right, they are put right in `views`.
    """
    _weigh(camera, num_tracks, constants, views, state, covariance, matches, offers)
    for turn in range(2):  # people who are believed to exist choose first
        num_choosers = num_free = 0
        for track in range(num_tracks):
            if confirmed[track] == (turn == 0):
                offers.choosers[num_choosers] = track
                num_choosers += 1
        for person in range(views.counts[camera]):
            if views.free[views.starts[camera] + person]:
                offers.people[num_free] = person
                num_free += 1
        if num_choosers > 0 and num_free > 0:
            _choose(camera, num_choosers, num_free, constants, views, matches, offers)


@kernel
def _weigh(
    camera: int,
    num_tracks: int,
    constants: Constants,
    views: Views,
    state: Floats,
    covariance: Floats,
    matches: Matches,
    offers: Offers,
) -> None:
    """Fill the costs of `offers` for every track and detection; assign nothing yet."""
    projection, size, scale = (
        constants.projections[camera],
        constants.sizes[camera],
        constants.scales[camera],
    )
    bias = (BIAS_PX * scale) ** 2
    first, num_people = views.starts[camera], views.counts[camera]
    for track in range(num_tracks):
        matches.assigned[camera, track] = -1
        matches.exchanged[camera, track] = 0
        matches.fits[camera, track] = 0.0
        inside = _look(
            constants.core, state[track], covariance[track], projection, size, offers.projected
        )
        matches.inside[camera, track] = inside >= INSIDE_JOINTS
        for person in range(num_people):
            row = first + person
            exchanged = exchanged_limbs(
                row,
                views.pixels,
                views.weights,
                views.variances,
                (SIDE_PX * scale) ** 2,
                offers.projected,
                constants.core,
                constants.opposites,
                constants.limbs,
            )
            exchange(row, exchanged, constants.opposites, constants.limbs, views)
            seen = views.weights, views.variances
            cost = _cost(row, constants.core, views.pixels, *seen, bias, offers.projected)
            vagueness = 0.0
            if cost <= COST_LIMIT:
                vagueness = _vagueness(row, constants.core, *seen, bias, offers.projected)
            exchange(row, exchanged, constants.opposites, constants.limbs, views)  # back again
            offers.exchanged[track, person] = exchanged
            offers.cost[track, person] = cost
            offers.vagueness[track, person] = vagueness


@kernel
def _choose(
    camera: int,
    num_choosers: int,
    num_free: int,
    constants: Constants,
    views: Views,
    matches: Matches,
    offers: Offers,
) -> None:
    """Assign the detections `offers.people` to the tracks `offers.choosers` at the least cost."""
    first = views.starts[camera]
    for chooser in range(num_choosers):
        for column in range(num_free):
            track, person = offers.choosers[chooser], offers.people[column]
            cost = offers.cost[track, person]
            likely = cost + offers.vagueness[track, person]
            offers.offered[chooser, column] = likely if cost <= COST_LIMIT else NEVER
    assign(offers.offered, num_choosers, num_free, offers.reals, offers.integers, offers.flags)
    for chooser in range(num_choosers):
        column = offers.integers[0, chooser]
        if column < 0:
            continue
        track, person = offers.choosers[chooser], offers.people[column]
        if not offers.cost[track, person] <= COST_LIMIT:
            continue
        exchanged = offers.exchanged[track, person]
        matches.assigned[camera, track] = person
        matches.exchanged[camera, track] = exchanged
        exchange(first + person, exchanged, constants.opposites, constants.limbs, views)
        matches.fits[camera, track] = fit_of(offers.cost[track, person])
        views.free[first + person] = False


@kernel
def fit_of(cost: float) -> float:
    """Return how well a detection of some cost fits a track, in [0, 1]."""
    return min(max(1.0 - (cost - COST_USUAL) / (COST_LIMIT - COST_USUAL), 0.0), 1.0)


@kernel
def _look(
    core: Integers,
    state: Floats,
    covariance: Floats,
    projection: Floats,
    size: Floats,
    projected: Floats,
) -> int:
    """Project the core joints of a track into `projected`; return how many fall into the image.

    `state` is `(num_joints, 6)`, `covariance` `(num_joints, 6, 6)`.
    """
    inside = 0
    for joint in core:
        depth, u, v, ux, uy, uz, vx, vy, vz = shown_at(
            projection, state[joint, 0], state[joint, 1], state[joint, 2]
        )
        in_front = depth > MIN_DEPTH_M
        projected[U, joint] = u
        projected[V, joint] = v
        projected[SPREAD, joint] = projected_variance_px2(covariance[joint], ux, uy, uz, vx, vy, vz)
        projected[IN_FRONT, joint] = 1.0 if in_front else 0.0
        inside += in_front and 0 < u < size[0] and 0 < v < size[1]
    return inside


@kernel
def _cost(
    row: int,
    core: Integers,
    pixels: Floats,
    weights: Floats,
    variances: Floats,
    bias: float,
    projected: Floats,
) -> float:
    """Return the mean distance of a detection in standard deviations; inf if unknown."""
    shown = 0
    total = weighted = 0.0
    for joint in core:
        weight = weights[row, joint]
        if weight > USED_SCORE and projected[IN_FRONT, joint] > 0:
            du = pixels[row, joint, 0] - projected[U, joint]
            dv = pixels[row, joint, 1] - projected[V, joint]
            variance = variances[row, joint] + bias + projected[SPREAD, joint]
            distance = math.sqrt((du * du + dv * dv) / variance)
            shown += 1
            total += weight
            weighted += weight * (distance if distance < JOINT_LIMIT else JOINT_LIMIT)
    if shown < MIN_JOINTS:
        return np.inf
    return weighted / (total if total > 1e-9 else 1e-9)


@kernel
def _vagueness(
    row: int,
    core: Integers,
    weights: Floats,
    variances: Floats,
    bias: float,
    projected: Floats,
) -> float:
    """Return the mean logarithm of how much wider a track is than one that is known exactly."""
    total = weighted = 0.0
    for joint in core:
        weight = weights[row, joint]
        if weight > USED_SCORE and projected[IN_FRONT, joint] > 0:
            total += weight
            weighted += weight * math.log1p(
                projected[SPREAD, joint] / (variances[row, joint] + bias)
            )
    return 0.5 * weighted / (total if total > 1e-9 else 1e-9)
