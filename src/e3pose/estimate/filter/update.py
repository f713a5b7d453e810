"""Predict and update: one Kalman filter per person, measured directly by pixels of any views."""

from __future__ import annotations

import math

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.bias import inflation
from e3pose.estimate.filter.outliers import MEASURED_SIGMAS, ROBUST
from e3pose.estimate.filter.projected import USED_SCORE, projected_variance_px2
from e3pose.estimate.filter.proportions import BONE_MEMORY, BONE_TEACHERS, expect_lengths
from e3pose.estimate.filter.scratch import Constants, Passes, Tracks, Views
from e3pose.estimate.filter.tree import eliminate, prepare, spread_out
from e3pose.estimate.filter.unchanged import pull_still
from e3pose.model.projection import MIN_DEPTH_M, shown_at

ITERATIONS = 3  # numerics: of Gauss-Newton
# tuned: m | not recorded | usual feet
USUAL_SLACK_M = 0.05  # of a length that is not learned
# tuned: m | not recorded | learned bones
BONE_KNOWN_M = 0.05  # both ends must be known better than this, per axis, to teach a length


@kernel
def update(
    track: int,
    dt: float,
    constants: Constants,
    views: Views,
    assigned: Integers,
    tracks: Tracks,
    passes: Passes,
) -> float:
    """Update a track with the views of the slot and the lengths of its bones.

    `assigned` is that of `Matches`, `dt` the seconds since the slot before. Returns the variance of
    the logarithm of the person's size, as its lengths were before the slot.
    """
    state, covariance = tracks.state[track], tracks.covariance[track]
    num_joints, num_cameras = len(state), len(views.counts)
    blocks = covariance.reshape(num_joints, 36)
    shared = tracks.shared[track].reshape(num_joints, 36)
    moved = passes.moved
    prepare(
        constants.order,
        constants.parents,
        blocks,
        shared,
        passes.prior_own,
        passes.prior_across,
        passes.own,
        passes.room,
    )
    size_variance = _expect_bones(track, constants, tracks, passes)
    for joint in range(num_joints):
        passes.measured[joint] = False
        for axis in range(6):
            moved[joint, axis] = 0.0
    shown = False
    for camera in range(num_cameras):
        shown |= views.arrived[camera] and assigned[camera, track] >= 0
    for iteration in range(ITERATIONS):
        _pull_views(track, dt, iteration == 0, constants, views, assigned, tracks, passes)
        if shown:  # else two joints would make each other surer without anybody having looked
            _pull_loose_bones(covariance, constants, passes)
        _sum_up(passes)
        _pull_links(constants, passes)
        eliminate(constants.order, constants.parents, passes.own, passes.across, passes.pull, moved)
    for joint in range(num_joints):
        for axis in range(6):
            state[joint, axis] += moved[joint, axis]
        if passes.measured[joint]:
            tracks.unmeasured_s[track, joint] = 0.0
    spread_out(
        constants.order, constants.parents, passes.own, passes.across, blocks, shared, passes.room
    )
    return size_variance


@kernel
def _expect_bones(track: int, constants: Constants, tracks: Tracks, passes: Passes) -> float:
    """Fill the lengths and slacks of bones: of limbs by proportions, of others as learned."""
    bones_m, counts = tracks.bones_m[track], tracks.bone_counts[track]
    size_variance = expect_lengths(
        bones_m,
        counts,
        constants.body,
        passes.kinds,
        passes.lengths_m,
        passes.variances,
    )
    for bone in range(len(bones_m)):
        slack_m = constants.body.slacks_m[bone]
        if constants.body.kinds[bone] >= 0:
            spread_m2 = passes.variances[bone] * passes.lengths_m[bone] ** 2
            passes.slacks_m[bone] = math.sqrt(slack_m**2 + spread_m2)
        else:
            passes.lengths_m[bone] = bones_m[bone]
            passes.slacks_m[bone] = slack_m if counts[bone] > BONE_TEACHERS else 0.0
    return size_variance


@kernel
def _pull_views(
    track: int,
    dt: float,
    first: bool,
    constants: Constants,
    views: Views,
    assigned: Integers,
    tracks: Tracks,
    passes: Passes,
) -> None:
    """Start a pass: sum up in `passes.seen` the information of all views about each joint."""
    state, covariance = tracks.state[track], tracks.covariance[track]
    places, moved, seen = passes.places, passes.moved, passes.seen
    for joint in range(len(state)):
        for axis in range(3):
            places[joint, axis] = state[joint, axis] + moved[joint, axis]
        for entry in range(18):
            seen[joint, entry] = 0.0
    for camera in range(len(views.counts)):
        if views.arrived[camera] and assigned[camera, track] >= 0:
            _pull_view(
                views.starts[camera] + assigned[camera, track],
                covariance,
                constants.projections[camera],
                views,
                tracks.bias_px[track, camera],
                inflation(tracks.last_seen_s[track, camera] + dt, constants.memory),
                first,
                passes,
            )
        elif views.unchanged[camera] and assigned[camera, track] >= 0:
            pull_still(
                views.starts[camera] + assigned[camera, track],
                views.pace_px[camera],
                state,
                covariance,
                constants.projections[camera],
                views.weights,
                first,
                passes,
            )


@kernel
def _pull_view(
    row: int,
    covariance: Floats,
    projection: Floats,
    views: Views,
    bias_px: Floats,
    factor: float,
    first: bool,
    passes: Passes,
) -> None:
    """Add the information of one detection about each joint to `seen`; mark measured joints.

    `factor` is on its variances.
    """
    pixels, weights, variances = views.pixels, views.weights, views.variances
    places, moved, seen, measured = passes.places, passes.moved, passes.seen, passes.measured
    for joint in range(len(places)):
        if not weights[row, joint] > USED_SCORE:
            continue
        x, y, z = places[joint, 0], places[joint, 1], places[joint, 2]
        depth, u, v, ux, uy, uz, vx, vy, vz = shown_at(projection, x, y, z)
        if not depth > MIN_DEPTH_M:
            continue
        xx, xy, xz = ux * ux + vx * vx, ux * uy + vx * vy, ux * uz + vx * vz
        yy, yz, zz = uy * uy + vy * vy, uy * uz + vy * vz, uz * uz + vz * vz
        variance = variances[row, joint] * factor
        expected = variance
        if first:  # a prediction may be off by more than a keypoint
            expected += projected_variance_px2(covariance[joint], ux, uy, uz, vx, vy, vz)
        du = pixels[row, joint, 0] - bias_px[joint, 0] - u
        dv = pixels[row, joint, 1] - bias_px[joint, 1] - v
        off = (du * du + dv * dv) / expected
        measured[joint] |= off < MEASURED_SIGMAS**2
        weight = 1.0 / ((1.0 + off * ROBUST) * variance)
        du += ux * moved[joint, 0] + uy * moved[joint, 1] + uz * moved[joint, 2]
        dv += vx * moved[joint, 0] + vy * moved[joint, 1] + vz * moved[joint, 2]
        seen[joint, 0] += weight * xx
        seen[joint, 1] += weight * xy
        seen[joint, 2] += weight * yy
        seen[joint, 3] += weight * xz
        seen[joint, 4] += weight * yz
        seen[joint, 5] += weight * zz
        seen[joint, 6] += weight * (ux * du + vx * dv)
        seen[joint, 7] += weight * (uy * du + vy * dv)
        seen[joint, 8] += weight * (uz * du + vz * dv)


@kernel
def _pull_loose_bones(
    covariance: Floats,
    constants: Constants,
    passes: Passes,
) -> None:
    """Add the information of bones outside the tree to either end, with the other end fixed."""
    bones, loose = constants.body.bones, constants.loose
    bones_m, slacks_m = passes.lengths_m, passes.slacks_m
    places, moved, seen = passes.places, passes.moved, passes.seen
    for bone in range(len(bones_m)):
        if not (loose[bone] and slacks_m[bone] > 0):
            continue
        first, second = bones[bone, 0], bones[bone, 1]
        x = places[first, 0] - places[second, 0]
        y = places[first, 1] - places[second, 1]
        z = places[first, 2] - places[second, 2]
        length = math.sqrt(x * x + y * y + z * z)
        length = length if length > 1e-6 else 1e-6
        x, y, z = x / length, y / length, z / length
        excess = length - bones_m[bone]
        for turn in range(2):
            joint, other, sign = (first, second, 1.0) if turn == 0 else (second, first, -1.0)
            spread = (
                covariance[other, 0, 0] * x * x
                + covariance[other, 1, 1] * y * y
                + covariance[other, 2, 2] * z * z
            )
            spread += 2.0 * (
                covariance[other, 0, 1] * x * y
                + covariance[other, 0, 2] * x * z
                + covariance[other, 1, 2] * y * z
            )
            weight = 1.0 / (spread / 2 + slacks_m[bone] ** 2)
            gone = moved[joint, 0] * x + moved[joint, 1] * y + moved[joint, 2] * z
            pull = weight * (gone - sign * excess)
            seen[joint, 0] += weight * x * x
            seen[joint, 1] += weight * x * y
            seen[joint, 2] += weight * y * y
            seen[joint, 3] += weight * x * z
            seen[joint, 4] += weight * y * z
            seen[joint, 5] += weight * z * z
            seen[joint, 6] += pull * x
            seen[joint, 7] += pull * y
            seen[joint, 8] += pull * z


@kernel
def _sum_up(passes: Passes) -> None:
    """Start a pass with the prior and the views."""
    for joint in range(len(passes.moved)):
        for entry in range(36):
            passes.own[joint, entry] = passes.prior_own[joint, entry]
            passes.across[joint, entry] = passes.prior_across[joint, entry]
        entry = 0
        for a in range(3):
            for b in range(a + 1):
                passes.own[joint, 6 * a + b] += passes.seen[joint, entry]
                passes.own[joint, 6 * a + b + 21] += passes.seen[joint, entry + 9]
                entry += 1
            passes.pull[joint, a] = passes.seen[joint, 6 + a]
            passes.pull[joint, a + 3] = passes.seen[joint, 15 + a]


@kernel
def _pull_links(
    constants: Constants,
    passes: Passes,
) -> None:
    """Add the information of the bones of the tree to both ends jointly."""
    links, parents, usual_m = constants.body.links, constants.parents, constants.usual_m
    places, moved = passes.places, passes.moved
    bones_m, slacks_m = passes.lengths_m, passes.slacks_m
    own, across, pull = passes.own, passes.across, passes.pull
    for joint in range(len(links)):
        bone, parent = links[joint], parents[joint]
        if bone >= 0 and slacks_m[bone] > 0:
            bone_m, slack_m = bones_m[bone], slacks_m[bone]
        elif usual_m[joint] > 0:
            bone_m, slack_m = usual_m[joint], USUAL_SLACK_M
        else:
            continue
        squares = turned = 0.0
        for axis in range(3):
            between = places[joint, axis] - places[parent, axis]
            squares += between * between
            turned += (moved[joint, axis] - moved[parent, axis]) * between
        length = math.sqrt(squares)
        length = length if length > 1e-6 else 1e-6
        weight = 1.0 / slack_m**2
        excess = length - bone_m - turned / length
        for a in range(3):
            along = (places[joint, a] - places[parent, a]) / length
            pull[joint, a] -= weight * excess * along
            pull[parent, a] += weight * excess * along
            for b in range(3):
                both = weight * along * (places[joint, b] - places[parent, b]) / length
                across[joint, 6 * a + b] -= both
                if b <= a:
                    own[joint, 6 * a + b] += both
                    own[parent, 6 * a + b] += both


@kernel
def learn_bones(
    state: Floats,
    covariance: Floats,
    unmeasured_s: Floats,
    bones: Integers,
    bones_m: Floats,
    counts: Floats,
    accurate: Flags,
) -> None:
    """Learn bone lengths from joints that are accurate and just measured.

    All of one track; `accurate` is scratch `(num_joints,)`.
    """
    for joint in range(len(state)):
        spread = covariance[joint, 0, 0] + covariance[joint, 1, 1] + covariance[joint, 2, 2]
        accurate[joint] = unmeasured_s[joint] == 0 and spread < 3 * BONE_KNOWN_M**2
    for bone in range(len(bones_m)):
        first, second = bones[bone, 0], bones[bone, 1]
        if not (accurate[first] and accurate[second]):
            continue
        squares = 0.0
        for axis in range(3):
            squares += (state[first, axis] - state[second, axis]) ** 2
        count = counts[bone] if counts[bone] < BONE_MEMORY else float(BONE_MEMORY)
        bones_m[bone] = (bones_m[bone] * count + math.sqrt(squares)) / (count + 1.0)
        counts[bone] = count + 1.0
