"""Constants of a rig, rules, and workspace of the kernels of one slot."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.base.kernel import LANES
from e3pose.estimate.per_slot.triangulate import MIN_VIEWS
from e3pose.model.undistort import Lenses

PLANES = 4  # layout: of a tile, as `gather` fills it
CAMERA, ROW, LABEL, NEAREST, ALIVE, SIZE, MEMBER = range(7)  # the rows of `Workspace.integers`


class Site(NamedTuple):
    """Constants of a rig."""

    ray_matrices: Floats  # (num_cameras, 3, 3)
    centers_m: Floats  # (num_cameras, 3)
    projections: Floats  # (num_cameras, 3, 4)
    lenses: Lenses
    fundamentals: Floats  # (num_cameras, num_cameras, 3, 3)


class Rules(NamedTuple):
    """`FusionSettings`, as kernels take them."""

    max_distance_m: float
    cap_m: float
    duplicate_m: float
    min_joints: int
    steps: int
    reject_outliers: bool
    matcher: int
    epipolar_px: float


class Workspace(NamedTuple):
    """Scratch of a slot of at most `capacity` poses, allocated once."""

    pixels: Floats  # (capacity, num_joints, 2)
    scores: Floats  # (capacity, num_joints)
    tiles: Floats
    tile_centers: Floats
    lanes: Floats
    sums: Floats  # (capacity, capacity)
    weights: Floats  # (capacity, capacity)
    distance: Floats  # (capacity,)
    strength: Floats  # (capacity,)
    precisions: Floats  # (capacity, num_joints)
    small: Floats  # (4, 4, 4)
    integers: Integers  # (7, capacity)
    joints_m: Floats  # (capacity // 2, num_joints, 3)
    joint_scores: Floats  # (capacity // 2, num_joints)
    errors_px: Floats  # (capacity // 2, num_joints)
    members: Integers  # (capacity // 2, num_cameras)


def make_workspace(num_cameras: int, num_joints: int, capacity: int) -> Workspace:
    """Allocate scratch; `capacity` is rounded up to whole tiles."""
    num_tiles = max(1, -(-capacity // LANES))
    capacity = num_tiles * LANES
    people = capacity // MIN_VIEWS
    return Workspace(
        pixels=np.zeros((capacity, num_joints, 2)),
        scores=np.zeros((capacity, num_joints)),
        tiles=np.zeros((num_tiles, num_joints * PLANES * LANES)),
        tile_centers=np.zeros((num_tiles, 3 * LANES)),
        lanes=np.zeros(6 * LANES),
        sums=np.zeros((capacity, capacity)),
        weights=np.zeros((capacity, capacity)),
        distance=np.zeros(capacity),
        strength=np.zeros(capacity),
        precisions=np.zeros((capacity, num_joints)),
        small=np.zeros((4, 4, 4)),
        integers=np.zeros((7, capacity), np.int64),
        joints_m=np.zeros((people, num_joints, 3)),
        joint_scores=np.zeros((people, num_joints)),
        errors_px=np.zeros((people, num_joints)),
        members=np.zeros((people, num_cameras), np.int64),
    )
