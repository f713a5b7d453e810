"""From pixels to world rays, and the distances between the rays of all pairs of poses.

Poses are stored in tiles of `LANES`: `tiles[tile, (joint * PLANES + plane) * LANES + lane]`, with
the planes x, y, z of the ray and the score. The innermost loop runs over the lanes of one tile with
constant bounds and offsets, which is what lets the compiler turn it into vector instructions.
"""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.base.kernel import LANES, kernel
from e3pose.estimate.per_slot.triangulate import noise_px
from e3pose.estimate.per_slot.workspace import CAMERA, PLANES, ROW, Site, Workspace
from e3pose.model.pose import MAX_PIXEL, MISSING_SCORE

# Squared sine of the angle under which two rays count as parallel: their distance says nothing.
PARALLEL_SINE2 = 1e-9  # numerics: of parallel rays


@kernel
def gather(
    scores: Floats,
    counts: Integers,
    site: Site,
    workspace: Workspace,
) -> int:
    """Fill scores, precisions and tiles, pose by pose; return the number of poses.

    `workspace.pixels` are undistorted; they become 0 where not seen.
    """
    pixels, tiles, tile_centers = workspace.pixels, workspace.tiles, workspace.tile_centers
    cameras, rows = workspace.integers[CAMERA], workspace.integers[ROW]
    num_joints = scores.shape[2]
    pose = 0
    for camera in range(len(counts)):
        m = site.ray_matrices[camera]
        for row in range(counts[camera]):
            tile, lane = pose // LANES, pose % LANES
            cameras[pose] = camera
            rows[pose] = row
            for axis in range(3):
                tile_centers[tile, axis * LANES + lane] = site.centers_m[camera, axis]
            for joint in range(num_joints):
                u, v = pixels[pose, joint, 0], pixels[pose, joint, 1]
                score = scores[camera, row, joint]
                if score > 1.0:  # unlike min(), leaves NaN alone
                    score = 1.0
                x = y = z = precision = 0.0
                if score >= MISSING_SCORE and abs(u) <= MAX_PIXEL and abs(v) <= MAX_PIXEL:
                    x = m[0, 0] * u + m[0, 1] * v + m[0, 2]
                    y = m[1, 0] * u + m[1, 1] * v + m[1, 2]
                    z = m[2, 0] * u + m[2, 1] * v + m[2, 2]
                    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
                    x, y, z = x * scale, y * scale, z * scale
                    precision = 1.0 / noise_px(score)
                else:
                    pixels[pose, joint, 0] = pixels[pose, joint, 1] = score = 0.0
                workspace.scores[pose, joint] = score
                workspace.precisions[pose, joint] = precision
                at = joint * PLANES * LANES + lane
                tiles[tile, at] = x
                tiles[tile, at + LANES] = y
                tiles[tile, at + 2 * LANES] = z
                tiles[tile, at + 3 * LANES] = score
            pose += 1
    if pose % LANES:  # empty lanes must not hold the poses of an earlier slot
        for joint in range(num_joints):
            for lane in range(pose % LANES, LANES):
                tiles[pose // LANES, (joint * PLANES + 3) * LANES + lane] = 0.0
    return pose


@kernel
def measure_pairs(
    num_poses: int,
    cap_m: float,
    workspace: Workspace,
) -> None:
    """Fill the symmetric sums and weights of all pairs; pairs of one view are infinite."""
    cameras, lanes = workspace.integers[CAMERA], workspace.lanes
    sums, weights = workspace.sums, workspace.weights
    num_tiles = (num_poses + LANES - 1) // LANES
    for pose in range(num_poses):
        first = pose + 1
        while first < num_poses and cameras[first] == cameras[pose]:
            sums[pose, first] = sums[first, pose] = np.inf
            weights[pose, first] = weights[first, pose] = 0.0
            first += 1
        sums[pose, pose] = np.inf
        weights[pose, pose] = 0.0
        for tile in range(first // LANES, num_tiles):
            measure_tile(pose, tile, cap_m, workspace)
            start = tile * LANES
            for other in range(max(first, start), min(start + LANES, num_poses)):
                lane = other - start
                sums[pose, other] = sums[other, pose] = lanes[3 * LANES + lane]
                weights[pose, other] = weights[other, pose] = lanes[4 * LANES + lane]


@kernel
def measure_tile(
    pose: int,
    number: int,
    cap_m: float,
    workspace: Workspace,
) -> None:
    """Measure one pose against the poses of a tile: the fourth and fifth row of `lanes`."""
    own, own_lane = workspace.tiles[pose // LANES], pose % LANES
    own_center = workspace.tile_centers[pose // LANES]
    tile, centers = workspace.tiles[number], workspace.tile_centers[number]
    lanes = workspace.lanes
    for lane in range(LANES):
        lanes[lane] = centers[lane] - own_center[own_lane]
        lanes[LANES + lane] = centers[LANES + lane] - own_center[LANES + own_lane]
        lanes[2 * LANES + lane] = centers[2 * LANES + lane] - own_center[2 * LANES + own_lane]
        lanes[3 * LANES + lane] = 0.0
        lanes[4 * LANES + lane] = 0.0
    for joint in range(workspace.scores.shape[1]):
        plane = joint * PLANES * LANES
        score = own[plane + 3 * LANES + own_lane]
        if score <= 0:
            continue
        ax = own[plane + own_lane]
        ay = own[plane + LANES + own_lane]
        az = own[plane + 2 * LANES + own_lane]
        joint_tile = tile[plane : plane + PLANES * LANES]
        for lane in range(LANES):
            x = joint_tile[lane]
            y = joint_tile[LANES + lane]
            z = joint_tile[2 * LANES + lane]
            bx = lanes[lane]
            by = lanes[LANES + lane]
            bz = lanes[2 * LANES + lane]
            nx = ay * z - az * y
            ny = az * x - ax * z
            nz = ax * y - ay * x
            sine2 = nx * nx + ny * ny + nz * nz
            cosine = ax * x + ay * y + az * z
            along_first = bx * ax + by * ay + bz * az
            along_second = bx * x + by * y + bz * z
            crossing = sine2 > PARALLEL_SINE2
            distance = abs(bx * nx + by * ny + bz * nz) / math.sqrt(sine2 if crossing else 1.0)
            near = distance < cap_m
            near &= along_first > cosine * along_second
            near &= cosine * along_first > along_second
            distance = distance if near else cap_m
            other = joint_tile[3 * LANES + lane]
            weight = score if score < other else other
            weight = weight if crossing else 0.0
            lanes[3 * LANES + lane] += weight * distance
            lanes[4 * LANES + lane] += weight
