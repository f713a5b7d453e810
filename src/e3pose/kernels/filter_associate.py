"""Associate: the loops of `filter.associate`, and which views should show whom."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.filter.associate import (
    BIAS_PX,
    COST_LIMIT,
    COST_USUAL,
    JOINT_LIMIT,
    MIN_JOINTS,
    NEVER,
)
from e3pose.filter.existence import INSIDE_JOINTS
from e3pose.filter.update import MIN_DEPTH_M, MIN_SCORE
from e3pose.kernels.compile import kernel
from e3pose.kernels.filter_assign import assign
from e3pose.kernels.filter_memory import Memory, Site

Floats = NDArray[np.float64]

U, V, SPREAD, IN_FRONT = range(4)  # planes of `Scratch.sight`


@kernel
def associate(camera: int, num_tracks: int, site: Site, memory: Memory) -> None:
    """Fill `assigned`, `fits` and `inside` of a camera whose view arrived, and `free` of it."""
    scratch, views = memory.scratch, memory.views
    assigned, fits = scratch.assigned[camera], scratch.fits[camera]
    first, num_people = views.starts[camera], views.counts[camera]
    for track in range(num_tracks):
        assigned[track] = -1
        fits[track] = 0.0
        inside = look(
            memory.tracks.state[track],
            memory.tracks.covariance[track],
            site.projections[camera],
            site.sizes[camera],
            scratch.sight,
        )
        scratch.inside[camera, track] = inside >= INSIDE_JOINTS
        for person in range(num_people):
            row = first + person
            scratch.cost[track, person] = cost_of(
                views.pixels[row],
                views.weights[row],
                views.variances[row],
                (BIAS_PX * site.scales[camera]) ** 2,
                scratch.sight,
            )
    for turn in range(2):  # people who are believed to exist choose first
        num_choosers = num_free = 0
        for track in range(num_tracks):
            if memory.tracks.confirmed[track] == (turn == 0):
                scratch.choosers[num_choosers] = track
                num_choosers += 1
        for person in range(num_people):
            if views.free[first + person]:
                scratch.people[num_free] = person
                num_free += 1
        if num_choosers == 0 or num_free == 0:
            continue
        for chooser in range(num_choosers):
            for column in range(num_free):
                cost = scratch.cost[scratch.choosers[chooser], scratch.people[column]]
                scratch.offered[chooser, column] = cost if cost <= COST_LIMIT else NEVER
        assign(
            scratch.offered, num_choosers, num_free, scratch.reals, scratch.integers, scratch.flags
        )
        for chooser in range(num_choosers):
            column = scratch.integers[0, chooser]
            if column < 0 or not scratch.offered[chooser, column] <= COST_LIMIT:
                continue
            track, person = scratch.choosers[chooser], scratch.people[column]
            excess = scratch.cost[track, person] - COST_USUAL
            assigned[track] = person
            fits[track] = min(max(1.0 - excess / (COST_LIMIT - COST_USUAL), 0.0), 1.0)
            views.free[first + person] = False


@kernel
def look(state: Floats, covariance: Floats, projection: Floats, size: Floats, sight: Floats) -> int:
    """Project the joints of a track into `sight`; return how many fall into the image.

    `state` is `(num_joints, 6)`, `covariance` `(num_joints, 6, 6)`.
    """
    inside = 0
    for joint in range(state.shape[0]):
        x, y, z = state[joint, 0], state[joint, 1], state[joint, 2]
        a = projection[0, 0] * x + projection[0, 1] * y + projection[0, 2] * z + projection[0, 3]
        b = projection[1, 0] * x + projection[1, 1] * y + projection[1, 2] * z + projection[1, 3]
        depth = (
            projection[2, 0] * x + projection[2, 1] * y + projection[2, 2] * z + projection[2, 3]
        )
        inverse = 1.0 / (depth if abs(depth) >= 1e-6 else 1e-6)
        u, v = a * inverse, b * inverse
        ux = (projection[0, 0] - u * projection[2, 0]) * inverse
        uy = (projection[0, 1] - u * projection[2, 1]) * inverse
        uz = (projection[0, 2] - u * projection[2, 2]) * inverse
        vx = (projection[1, 0] - v * projection[2, 0]) * inverse
        vy = (projection[1, 1] - v * projection[2, 1]) * inverse
        vz = (projection[1, 2] - v * projection[2, 2]) * inverse
        spread = (
            covariance[joint, 0, 0] * (ux * ux + vx * vx)
            + covariance[joint, 1, 1] * (uy * uy + vy * vy)
            + covariance[joint, 2, 2] * (uz * uz + vz * vz)
        )
        spread += 2.0 * (
            covariance[joint, 0, 1] * (ux * uy + vx * vy)
            + covariance[joint, 0, 2] * (ux * uz + vx * vz)
            + covariance[joint, 1, 2] * (uy * uz + vy * vz)
        )
        in_front = depth > MIN_DEPTH_M
        sight[U, joint] = u
        sight[V, joint] = v
        sight[SPREAD, joint] = spread / 2
        sight[IN_FRONT, joint] = 1.0 if in_front else 0.0
        inside += in_front and 0 < u < size[0] and 0 < v < size[1]
    return inside


@kernel
def cost_of(
    pixels: Floats, weights: Floats, variances: Floats, bias: float, sight: Floats
) -> float:
    """Return the mean distance of a detection in standard deviations; inf if unknown."""
    shown = 0
    total = weighted = 0.0
    for joint in range(len(weights)):
        if weights[joint] > MIN_SCORE and sight[IN_FRONT, joint] > 0:
            du, dv = pixels[joint, 0] - sight[U, joint], pixels[joint, 1] - sight[V, joint]
            variance = variances[joint] + bias + sight[SPREAD, joint]
            distance = math.sqrt((du * du + dv * dv) / variance)
            shown += 1
            total += weights[joint]
            weighted += weights[joint] * min(distance, JOINT_LIMIT)
    return weighted / max(total, 1e-9) if shown >= MIN_JOINTS else np.inf
