"""One slot in one compiled call, with the working workspace that it needs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.base.kernel import kernel
from e3pose.estimate.per_slot.dissolve import dissolve_groups, weigh_groups
from e3pose.estimate.per_slot.epipolar import (
    fundamental_matrices,
    match_epipolar,
    match_tanke_gall,
)
from e3pose.estimate.per_slot.fusion import MATCHERS, Fused, FusionSettings
from e3pose.estimate.per_slot.group import group_poses
from e3pose.estimate.per_slot.pairs import gather, measure_pairs
from e3pose.estimate.per_slot.triangulate import (
    MIN_VIEWS,
    refine_person,
    score_person,
    triangulate_person,
)
from e3pose.estimate.per_slot.workspace import (
    CAMERA,
    LABEL,
    MEMBER,
    ROW,
    SIZE,
    Rules,
    Site,
    Workspace,
    make_workspace,
)
from e3pose.model.camera import Rig
from e3pose.model.undistort import make_lenses, undistort_slot

RAYS, TANKE_GALL = MATCHERS.index("rays"), MATCHERS.index("tanke-gall")


class SlotKernel:
    """The kernel of `Fuser`, with the constants of a rig and the workspace."""

    def __init__(self, rig: Rig, num_joints: int, settings: FusionSettings) -> None:
        self._site = Site(
            np.ascontiguousarray(rig.ray_matrices),
            np.ascontiguousarray(rig.centers_m),
            np.ascontiguousarray(rig.projections),
            make_lenses(rig),
            np.ascontiguousarray(fundamental_matrices(rig)),
        )
        self._call: Any = fuse_slot
        self._rules = Rules(
            settings.max_distance_m,
            settings.cap_m,
            settings.duplicate_m,
            min(settings.min_joints, num_joints),
            settings.steps,
            settings.reject_outliers,
            MATCHERS.index(settings.matcher),
            settings.epipolar_px,
        )
        self._workspace = make_workspace(len(rig), num_joints, 8 * len(rig))

    def __call__(self, keypoints_px: Floats, scores: Floats, counts: Integers) -> Fused:
        """Fuse one slot; arguments as in `Fuser.fuse_arrays`."""
        workspace = self._workspace
        if counts.sum() > len(workspace.strength):
            num_cameras, num_joints = len(counts), scores.shape[2]
            workspace = make_workspace(num_cameras, num_joints, 2 * int(counts.sum()))
            self._workspace = workspace
        people: int = self._call(keypoints_px, scores, counts, self._site, self._rules, workspace)
        return (
            workspace.joints_m[:people].copy(),
            workspace.joint_scores[:people].copy(),
            workspace.members[:people].copy(),
            workspace.errors_px[:people].copy(),
        )


@kernel
def fuse_slot(
    keypoints_px: Floats,
    scores: Floats,
    counts: Integers,
    site: Site,
    rules: Rules,
    workspace: Workspace,
) -> int:
    """Match and triangulate one slot into the last four arrays of `workspace`; return people."""
    undistort_slot(
        keypoints_px,
        scores,
        counts,
        site.lenses.models,
        site.lenses.numbers,
        site.lenses.tables,
        workspace.lanes,
        workspace.pixels,
    )
    num_poses = gather(scores, counts, site, workspace)
    if rules.matcher == RAYS:
        _match_rays(num_poses, rules.max_distance_m, rules.cap_m, workspace)
    else:
        _match_epipolar(num_poses, rules.matcher, site.fundamentals, rules.epipolar_px, workspace)
    people = 0
    while True:
        group = _take_strongest(num_poses, workspace)
        if len(group) == 0:
            return people
        people += _fuse_person(group, people, site.projections, rules, workspace)


@kernel
def _fuse_person(
    group: Integers,
    person: int,
    projections: Floats,
    rules: Rules,
    workspace: Workspace,
) -> bool:
    """Triangulate a group of poses into row `person` of `workspace`; return whether it is a person.

    With fewer than `min_joints` it is none, nor, matched by rays, within `duplicate_m` of another.
    """
    cameras, rows = workspace.integers[CAMERA], workspace.integers[ROW]
    joints_m = workspace.joints_m[person]
    found = triangulate_person(
        group, cameras, workspace.pixels, workspace.scores, projections, workspace.small, joints_m
    )
    if found < rules.min_joints:
        return False
    if rules.steps > 0:
        refine_person(
            group,
            cameras,
            workspace.pixels,
            workspace.precisions,
            projections,
            rules.steps,
            rules.reject_outliers,
            joints_m,
        )
    near_m = rules.duplicate_m if rules.matcher == RAYS else 0.0
    if near_m > 0 and _is_duplicate(workspace.joints_m, person, near_m):
        return False
    score_person(
        group,
        cameras,
        workspace.pixels,
        workspace.scores,
        workspace.precisions,
        projections,
        rules.reject_outliers,
        joints_m,
        workspace.joint_scores[person],
        workspace.errors_px[person],
    )
    workspace.members[person] = -1
    for index in range(len(group)):
        workspace.members[person, cameras[group[index]]] = rows[group[index]]
    return True


@kernel
def _match_epipolar(
    num_poses: int, matcher: int, fundamentals: Floats, max_epipolar_px: float, workspace: Workspace
) -> None:
    """Group poses by person by epipolar lines: their labels, group sizes and strengths."""
    if matcher == TANKE_GALL:
        match_tanke_gall(num_poses, fundamentals, max_epipolar_px, workspace)
    else:
        match_epipolar(num_poses, fundamentals, max_epipolar_px, workspace)
    weigh_groups(num_poses, workspace)


@kernel
def _match_rays(num_poses: int, max_distance_m: float, cap_m: float, workspace: Workspace) -> None:
    """Group poses by person, the closest first: their labels, group sizes and strengths."""
    measure_pairs(num_poses, cap_m, workspace)
    group_poses(num_poses, max_distance_m, cap_m, workspace)
    weigh_groups(num_poses, workspace)
    dissolve_groups(num_poses, max_distance_m, cap_m, workspace)


@kernel
def _take_strongest(num_poses: int, workspace: Workspace) -> Integers:
    """Return the poses of the strongest remaining group, by camera; empty if there is none."""
    labels, sizes = workspace.integers[LABEL], workspace.integers[SIZE]
    strongest = -1
    for pose in range(num_poses):
        stronger = strongest < 0 or workspace.strength[pose] > workspace.strength[strongest]
        if sizes[pose] >= MIN_VIEWS and stronger:
            strongest = pose
    if strongest < 0:
        return workspace.integers[MEMBER, :0]
    group = workspace.integers[MEMBER, : sizes[strongest]]
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
