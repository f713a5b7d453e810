"""Update: the loops of `filter.update.update`, for one track.

A view measures positions only, so the information it adds to the 6 x 6 of a joint is a 3 x 3 block
M. With S the predicted covariance, S_p its first three columns and S_pp their first three rows,

    x = x_predicted + S_p (1 + M S_pp)^-1 r,    S - S_p (1 + M S_pp)^-1 M S_p'

is what the reference finds by inverting 6 x 6 matrices.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.filter.update import (
    BONE_KNOWN_M,
    BONE_MEMORY,
    BONE_TEACHERS,
    ITERATIONS,
    MEASURED_SIGMAS,
    MIN_DEPTH_M,
    MIN_SCORE,
    OUTLIER_SIGMAS,
)
from e3pose.kernels.compile import kernel
from e3pose.kernels.filter_memory import Passes, Site, Tracks, Views

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

ROBUST = 1.0 / OUTLIER_SIGMAS**2


@kernel
def update(
    track: int,
    site: Site,
    views: Views,
    assigned: Integers,
    tracks: Tracks,
    passes: Passes,
) -> None:
    """Move a track to what the views of the slot and the learned bones say.

    `assigned` is that of `Matches`.
    """
    state, covariance = tracks.state[track], tracks.covariance[track]
    now, then = passes.places[0], passes.places[1]
    pulls, measured = passes.pulls, passes.measured
    num_joints, num_cameras = len(state), len(views.counts)
    for joint in range(num_joints):
        measured[joint] = False
        for axis in range(3):
            now[joint, axis] = state[joint, axis]
    for iteration in range(ITERATIONS):
        for joint in range(num_joints):
            for entry in range(9):
                pulls[joint, entry] = 0.0
        _pull_bones(
            now,
            covariance,
            tracks.bones_m[track],
            tracks.bone_counts[track],
            site.bones,
            site.slacks_m,
            pulls,
        )
        for camera in range(num_cameras):
            if views.arrived[camera] and assigned[camera, track] >= 0:
                _pull_view(
                    views.starts[camera] + assigned[camera, track],
                    now,
                    covariance,
                    site.projections[camera],
                    views.pixels,
                    views.weights,
                    views.variances,
                    iteration == 0,
                    pulls,
                    measured,
                )
        for joint in range(num_joints):
            _solve(joint, pulls, now, then, state, covariance, iteration == ITERATIONS - 1)
        now, then = then, now
    for joint in range(num_joints):
        if measured[joint]:
            tracks.unmeasured_s[track, joint] = 0.0


@kernel
def _pull_view(
    row: int,
    places: Floats,
    covariance: Floats,
    projection: Floats,
    pixels: Floats,
    weights: Floats,
    variances: Floats,
    first: bool,
    pulls: Floats,
    measured: Flags,
) -> None:
    """Add to the pulls of each joint what one detection says; note what it measures."""
    for joint in range(len(places)):
        if not weights[row, joint] > MIN_SCORE:
            continue
        x, y, z = places[joint, 0], places[joint, 1], places[joint, 2]
        depth = (
            projection[2, 0] * x + projection[2, 1] * y + projection[2, 2] * z + projection[2, 3]
        )
        if not depth > MIN_DEPTH_M:
            continue
        inverse = 1.0 / depth
        u = inverse * (
            projection[0, 0] * x + projection[0, 1] * y + projection[0, 2] * z + projection[0, 3]
        )
        v = inverse * (
            projection[1, 0] * x + projection[1, 1] * y + projection[1, 2] * z + projection[1, 3]
        )
        ux = (projection[0, 0] - u * projection[2, 0]) * inverse
        uy = (projection[0, 1] - u * projection[2, 1]) * inverse
        uz = (projection[0, 2] - u * projection[2, 2]) * inverse
        vx = (projection[1, 0] - v * projection[2, 0]) * inverse
        vy = (projection[1, 1] - v * projection[2, 1]) * inverse
        vz = (projection[1, 2] - v * projection[2, 2]) * inverse
        xx, xy, xz = ux * ux + vx * vx, ux * uy + vx * vy, ux * uz + vx * vz
        yy, yz, zz = uy * uy + vy * vy, uy * uz + vy * vz, uz * uz + vz * vz
        variance = variances[row, joint]
        expected = variance
        if first:  # a prediction may be off by more than a keypoint
            expected += (
                covariance[joint, 0, 0] * xx
                + covariance[joint, 1, 1] * yy
                + covariance[joint, 2, 2] * zz
            ) / 2
            expected += (
                covariance[joint, 0, 1] * xy
                + covariance[joint, 0, 2] * xz
                + covariance[joint, 1, 2] * yz
            )
        du, dv = pixels[row, joint, 0] - u, pixels[row, joint, 1] - v
        off = (du * du + dv * dv) / expected
        measured[joint] |= off < MEASURED_SIGMAS**2
        weight = 1.0 / ((1.0 + off * ROBUST) * variance)
        pulls[joint, 0] += weight * xx
        pulls[joint, 1] += weight * xy
        pulls[joint, 2] += weight * xz
        pulls[joint, 3] += weight * yy
        pulls[joint, 4] += weight * yz
        pulls[joint, 5] += weight * zz
        pulls[joint, 6] += weight * (ux * du + vx * dv)
        pulls[joint, 7] += weight * (uy * du + vy * dv)
        pulls[joint, 8] += weight * (uz * du + vz * dv)


@kernel
def _pull_bones(
    places: Floats,
    covariance: Floats,
    bones_m: Floats,
    counts: Floats,
    bones: Integers,
    slacks_m: Floats,
    pulls: Floats,
) -> None:
    """Add what the neighbours at known distances say; each thinks the other fixed."""
    for bone in range(len(bones_m)):
        if not counts[bone] > BONE_TEACHERS:
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
            joint, other, sign = (first, second, -1.0) if turn == 0 else (second, first, 1.0)
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
            pulls[joint, 0] += weight * x * x
            pulls[joint, 1] += weight * x * y
            pulls[joint, 2] += weight * x * z
            pulls[joint, 3] += weight * y * y
            pulls[joint, 4] += weight * y * z
            pulls[joint, 5] += weight * z * z
            pull = sign * weight * excess
            pulls[joint, 6] += pull * x
            pulls[joint, 7] += pull * y
            pulls[joint, 8] += pull * z


@kernel
def _solve(
    joint: int,
    pulls: Floats,
    now: Floats,
    then: Floats,
    state: Floats,
    covariance: Floats,
    last: bool,
) -> None:
    """Write the next place of a joint to `then`; the `last` time also its state and covariance."""
    xx, xy, xz = pulls[joint, 0], pulls[joint, 1], pulls[joint, 2]
    yy, yz, zz = pulls[joint, 3], pulls[joint, 4], pulls[joint, 5]
    s = covariance[joint]
    s00, s01, s02 = s[0, 0], s[0, 1], s[0, 2]
    s10, s11, s12 = s[1, 0], s[1, 1], s[1, 2]
    s20, s21, s22 = s[2, 0], s[2, 1], s[2, 2]
    dx = state[joint, 0] - now[joint, 0]
    dy = state[joint, 1] - now[joint, 1]
    dz = state[joint, 2] - now[joint, 2]
    r0 = pulls[joint, 6] - (xx * dx + xy * dy + xz * dz)
    r1 = pulls[joint, 7] - (xy * dx + yy * dy + yz * dz)
    r2 = pulls[joint, 8] - (xz * dx + yz * dy + zz * dz)
    a00 = 1.0 + xx * s00 + xy * s10 + xz * s20
    a01 = xx * s01 + xy * s11 + xz * s21
    a02 = xx * s02 + xy * s12 + xz * s22
    a10 = xy * s00 + yy * s10 + yz * s20
    a11 = 1.0 + xy * s01 + yy * s11 + yz * s21
    a12 = xy * s02 + yy * s12 + yz * s22
    a20 = xz * s00 + yz * s10 + zz * s20
    a21 = xz * s01 + yz * s11 + zz * s21
    a22 = 1.0 + xz * s02 + yz * s12 + zz * s22
    c00 = a11 * a22 - a12 * a21
    c10 = a12 * a20 - a10 * a22
    c20 = a10 * a21 - a11 * a20
    scale = 1.0 / (a00 * c00 + a01 * c10 + a02 * c20)
    i00, i10, i20 = scale * c00, scale * c10, scale * c20
    i01 = scale * (a02 * a21 - a01 * a22)
    i11 = scale * (a00 * a22 - a02 * a20)
    i21 = scale * (a01 * a20 - a00 * a21)
    i02 = scale * (a01 * a12 - a02 * a11)
    i12 = scale * (a02 * a10 - a00 * a12)
    i22 = scale * (a00 * a11 - a01 * a10)
    y0 = i00 * r0 + i01 * r1 + i02 * r2
    y1 = i10 * r0 + i11 * r1 + i12 * r2
    y2 = i20 * r0 + i21 * r1 + i22 * r2
    then[joint, 0] = state[joint, 0] + s00 * y0 + s01 * y1 + s02 * y2
    then[joint, 1] = state[joint, 1] + s10 * y0 + s11 * y1 + s12 * y2
    then[joint, 2] = state[joint, 2] + s20 * y0 + s21 * y1 + s22 * y2
    if not last:
        return
    for row in range(6):
        state[joint, row] += s[row, 0] * y0 + s[row, 1] * y1 + s[row, 2] * y2
    w00 = i00 * xx + i01 * xy + i02 * xz
    w01 = i00 * xy + i01 * yy + i02 * yz
    w02 = i00 * xz + i01 * yz + i02 * zz
    w11 = i10 * xy + i11 * yy + i12 * yz
    w12 = i10 * xz + i11 * yz + i12 * zz
    w22 = i20 * xz + i21 * yz + i22 * zz
    # From the last row up, so that what is still to be read is as it was.
    for row in range(5, -1, -1):
        p0, p1, p2 = s[row, 0], s[row, 1], s[row, 2]
        q0 = p0 * w00 + p1 * w01 + p2 * w02
        q1 = p0 * w01 + p1 * w11 + p2 * w12
        q2 = p0 * w02 + p1 * w12 + p2 * w22
        for column in range(row, -1, -1):
            s[row, column] -= q0 * s[column, 0] + q1 * s[column, 1] + q2 * s[column, 2]
    for row in range(6):
        for column in range(row):
            s[column, row] = s[row, column]


@kernel
def learn_bones(
    state: Floats,
    covariance: Floats,
    unmeasured_s: Floats,
    bones: Integers,
    bones_m: Floats,
    counts: Floats,
    known: Flags,
) -> None:
    """Let joints that are well known and were just measured teach how far apart they are.

    All of one track; `known` is scratch `(num_joints,)`.
    """
    for joint in range(len(state)):
        spread = covariance[joint, 0, 0] + covariance[joint, 1, 1] + covariance[joint, 2, 2]
        known[joint] = unmeasured_s[joint] == 0 and spread < 3 * BONE_KNOWN_M**2
    for bone in range(len(bones_m)):
        first, second = bones[bone, 0], bones[bone, 1]
        if not (known[first] and known[second]):
            continue
        squares = 0.0
        for axis in range(3):
            squares += (state[first, axis] - state[second, axis]) ** 2
        count = counts[bone] if counts[bone] < BONE_MEMORY else float(BONE_MEMORY)
        bones_m[bone] = (bones_m[bone] * count + math.sqrt(squares)) / (count + 1.0)
        counts[bone] = count + 1.0
