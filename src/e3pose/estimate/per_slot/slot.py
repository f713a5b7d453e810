"""One slot in one compiled call, with the working memory that it needs."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.per_slot.dissolve import dissolve_groups, weigh_groups
from e3pose.estimate.per_slot.epipolar import (
    fundamental_matrices,
    match_epipolar,
    match_tanke_gall,
)
from e3pose.estimate.per_slot.fusion import MATCHERS, Fused, FusionSettings
from e3pose.estimate.per_slot.group import group_poses
from e3pose.estimate.per_slot.pairs import PLANES, gather, measure_pairs
from e3pose.estimate.per_slot.triangulate import (
    MIN_VIEWS,
    refine_person,
    score_person,
    triangulate_person,
)
from e3pose.geometry.camera import Rig
from e3pose.geometry.undistort import make_lenses, undistort_slot
from e3pose.runtime.kernel import LANES, kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

RAYS, TANKE_GALL = MATCHERS.index("rays"), MATCHERS.index("tanke-gall")
CAMERA, ROW, LABEL, NEAREST, ALIVE, SIZE, MEMBER = range(7)  # the rows of `Memory.integers`


class Memory(NamedTuple):
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


def make_memory(num_cameras: int, num_joints: int, capacity: int) -> Memory:
    """Allocate scratch; `capacity` is rounded up to whole tiles."""
    num_tiles = max(1, -(-capacity // LANES))
    capacity = num_tiles * LANES
    people = capacity // MIN_VIEWS
    return Memory(
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


class SlotKernel:
    """What `Fuser` runs: keeps what is constant per rig, and the working memory."""

    def __init__(self, rig: Rig, num_joints: int, settings: FusionSettings) -> None:
        self._rig = (
            np.ascontiguousarray(rig.ray_matrices),
            np.ascontiguousarray(rig.centers_m),
            np.ascontiguousarray(rig.projections),
            *make_lenses(rig),
            np.ascontiguousarray(fundamental_matrices(rig)),
        )
        self._call: Any = fuse_slot
        self._settings = (
            settings.max_distance_m,
            settings.cap_m,
            settings.duplicate_m,
            min(settings.min_joints, num_joints),
            settings.steps,
            settings.reject_outliers,
            MATCHERS.index(settings.matcher),
            settings.epipolar_px,
        )
        self._memory = make_memory(len(rig), num_joints, 8 * len(rig))

    def __call__(self, keypoints_px: Floats, scores: Floats, counts: Integers) -> Fused:
        """Fuse one slot; the arguments are those of `Fuser.fuse_arrays`."""
        memory = self._memory
        if counts.sum() > len(memory.strength):
            num_cameras, num_joints = len(counts), scores.shape[2]
            memory = make_memory(num_cameras, num_joints, 2 * int(counts.sum()))
            self._memory = memory
        people: int = self._call(keypoints_px, scores, counts, *self._rig, *self._settings, memory)
        return (
            memory.joints_m[:people].copy(),
            memory.joint_scores[:people].copy(),
            memory.members[:people].copy(),
            memory.errors_px[:people].copy(),
        )


@kernel
def fuse_slot(
    keypoints_px: Floats,
    scores: Floats,
    counts: Integers,
    ray_matrices: Floats,
    centers_m: Floats,
    projections: Floats,
    lens_models: Integers,
    lens_numbers: Floats,
    lens_tables: Floats,
    fundamentals: Floats,
    max_distance_m: float,
    cap_m: float,
    duplicate_m: float,
    min_joints: int,
    steps: int,
    reject_outliers: bool,
    matcher: int,
    max_epipolar_px: float,
    memory: Memory,
) -> int:
    """Match and triangulate one slot into the last four arrays of `memory`; return the people."""
    undistort_slot(
        keypoints_px,
        scores,
        counts,
        lens_models,
        lens_numbers,
        lens_tables,
        memory.lanes,
        memory.pixels,
    )
    cameras, rows = memory.integers[CAMERA], memory.integers[ROW]
    num_poses = gather(
        scores,
        counts,
        ray_matrices,
        centers_m,
        memory.pixels,
        memory.scores,
        memory.precisions,
        cameras,
        rows,
        memory.tiles,
        memory.tile_centers,
    )
    if matcher == RAYS:
        _match_rays(num_poses, max_distance_m, cap_m, memory)
    else:
        _match_epipolar(num_poses, matcher, fundamentals, max_epipolar_px, memory)
    people = 0
    while True:
        group = _take_strongest(num_poses, memory)
        if len(group) == 0:
            return people
        people += _fuse_person(
            group,
            people,
            projections,
            duplicate_m if matcher == RAYS else -1.0,
            min_joints,
            steps,
            reject_outliers,
            memory,
        )


@kernel
def _fuse_person(
    group: Integers,
    person: int,
    projections: Floats,
    duplicate_m: float,
    min_joints: int,
    steps: int,
    reject_outliers: bool,
    memory: Memory,
) -> bool:
    """Triangulate a group of poses into row `person` of `memory`; return whether it is a person.

    With fewer than `min_joints` it is none, nor within `duplicate_m`, if positive, of another one.
    """
    cameras, rows = memory.integers[CAMERA], memory.integers[ROW]
    joints_m = memory.joints_m[person]
    found = triangulate_person(
        group, cameras, memory.pixels, memory.scores, projections, memory.small, joints_m
    )
    if found < min_joints:
        return False
    if steps > 0:
        refine_person(
            group,
            cameras,
            memory.pixels,
            memory.precisions,
            projections,
            steps,
            reject_outliers,
            joints_m,
        )
    if duplicate_m > 0 and _is_duplicate(memory.joints_m, person, duplicate_m):
        return False
    score_person(
        group,
        cameras,
        memory.pixels,
        memory.scores,
        memory.precisions,
        projections,
        reject_outliers,
        joints_m,
        memory.joint_scores[person],
        memory.errors_px[person],
    )
    memory.members[person] = -1
    for index in range(len(group)):
        memory.members[person, cameras[group[index]]] = rows[group[index]]
    return True


@kernel
def _match_epipolar(
    num_poses: int, matcher: int, fundamentals: Floats, max_epipolar_px: float, memory: Memory
) -> None:
    """Group poses by person by epipolar lines: their labels, group sizes and strengths."""
    labels = memory.integers[LABEL]
    arguments = (
        num_poses,
        memory.integers[CAMERA],
        memory.pixels,
        memory.scores,
        fundamentals,
        max_epipolar_px,
        labels,
        memory.sums,
    )
    if matcher == TANKE_GALL:
        match_tanke_gall(*arguments)
    else:
        match_epipolar(*arguments)
    weigh_groups(num_poses, labels, memory.scores, memory.integers[SIZE], memory.strength)


@kernel
def _match_rays(num_poses: int, max_distance_m: float, cap_m: float, memory: Memory) -> None:
    """Group poses by person, the closest first: their labels, group sizes and strengths."""
    cameras, labels = memory.integers[CAMERA], memory.integers[LABEL]
    nearest, sizes = memory.integers[NEAREST], memory.integers[SIZE]
    measure_pairs(
        num_poses,
        memory.scores.shape[1],
        cameras,
        memory.tiles,
        memory.tile_centers,
        cap_m,
        memory.lanes,
        memory.sums,
        memory.weights,
    )
    group_poses(
        num_poses,
        memory.sums,
        memory.weights,
        max_distance_m,
        cap_m,
        labels,
        nearest,
        memory.distance,
        memory.integers[ALIVE],
    )
    weigh_groups(num_poses, labels, memory.scores, sizes, memory.strength)
    dissolve_groups(
        num_poses,
        cameras,
        memory.scores,
        memory.tiles,
        memory.tile_centers,
        memory.lanes,
        max_distance_m,
        cap_m,
        labels,
        sizes,
        nearest,
        memory.strength,
        memory.distance,
        memory.weights[0],
    )


@kernel
def _take_strongest(num_poses: int, memory: Memory) -> Integers:
    """Return the poses of the strongest remaining group, by camera; empty if there is none."""
    labels, sizes = memory.integers[LABEL], memory.integers[SIZE]
    strongest = -1
    for pose in range(num_poses):
        stronger = strongest < 0 or memory.strength[pose] > memory.strength[strongest]
        if sizes[pose] >= MIN_VIEWS and stronger:
            strongest = pose
    if strongest < 0:
        return memory.integers[MEMBER, :0]
    group = memory.integers[MEMBER, : sizes[strongest]]
    count = 0
    for pose in range(num_poses):  # poses are stored by camera, so the group is too
        if labels[pose] == strongest:
            group[count] = pose
            count += 1
    sizes[strongest] = 0
    return group


@kernel
def _is_duplicate(joints_m: Floats, person: int, duplicate_m: float) -> bool:
    for other in range(person):
        shared = 0
        total = 0.0
        for joint in range(joints_m.shape[1]):
            squares = 0.0
            for axis in range(3):
                squares += (joints_m[person, joint, axis] - joints_m[other, joint, axis]) ** 2
            if math.isfinite(squares):
                shared += 1
                total += math.sqrt(squares)
        if shared > 0 and total < duplicate_m * shared:
            return True
    return False
