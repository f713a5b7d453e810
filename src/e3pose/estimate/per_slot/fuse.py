"""Fuse the views of one slot into 3D poses: match and triangulate.

A slot is one compiled call. Spurious groups are dissolved, and their poses go to the people they
belong to: in a crowd, poses of two people can meet by chance more closely than those of one person
do. So after grouping, weakest first, a group is dissolved if each of its poses is at home in a
larger one that has no pose of that view.

Match 2D poses across views by agglomerative clustering of ray distances.

The epipolar constraint is tested in the world: two keypoints of one joint span two rays, and the
rays of the same point pass each other closely. Its distance is in metres, so one threshold serves
near and far people and every camera. `docs/decisions/0001-matching.md` explains the choice.

Every pose begins as a group of its own. Again and again the two closest groups are merged, by the
mean ray distance over all their pairs of poses and joints (average link), unless both hold a pose
of the same view, until the closest two are further apart than `max_distance_m`. No view comes
first, so the order of views and people does not matter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats, Integers
from e3pose.base.errors import InputError
from e3pose.base.kernel import LANES, kernel
from e3pose.estimate.per_slot.epipolar import (
    fundamental_matrices,
    match_epipolar,
    match_tanke_gall,
)
from e3pose.estimate.per_slot.fusion import MATCHERS
from e3pose.estimate.per_slot.fusion import Fused as Fused
from e3pose.estimate.per_slot.fusion import Fusion as Fusion
from e3pose.estimate.per_slot.fusion import FusionSettings as FusionSettings
from e3pose.estimate.per_slot.pairs import gather, measure_pairs, measure_tile
from e3pose.estimate.per_slot.triangulate import (
    MIN_VIEWS,
    refine_person,
    score_person,
    triangulate_person,
)
from e3pose.estimate.per_slot.workspace import (
    ALIVE,
    CAMERA,
    LABEL,
    MEMBER,
    NEAREST,
    ROW,
    SIZE,
    Rules,
    Site,
    Workspace,
    make_workspace,
)
from e3pose.model.camera import Rig
from e3pose.model.people import People
from e3pose.model.pose import Poses2D
from e3pose.model.undistort import make_lenses, undistort_slot

MAX_POSES = 4096  # capacity: in one slot, all views together: 1 GB of working memory at most
RAYS, TANKE_GALL = MATCHERS.index("rays"), MATCHERS.index("tanke-gall")
# Sums of scores that differ by less are equal; then the first pose leads.
STRENGTH_UNIT = 1e-6  # numerics: of a sum of scores

# So many certain joints at the distance `cap_m` are added to what two groups have in common: a
# scrap of two joints needs more than a lucky coincidence, and larger groups merge before smaller.
# tuned: joints | simulated workloads, docs/decisions/0001-matching.md | by the truth, five views of
#   16 people: with 0 precision is 0.98, with 2 recall 0.996
PRIOR_JOINTS = 1.0


class Fuser:
    """Fuses slots of one rig; holds the constants of the rig and no history.

    Args:
        rig: the calibrated cameras.
        num_joints: joints of every pose.
        settings: thresholds.

    A fuser reuses its working memory, so it must not be shared between threads.
    """

    def __init__(
        self,
        rig: Rig,
        num_joints: int,
        settings: FusionSettings | None = None,
    ) -> None:
        if num_joints < 1:
            raise InputError(f"fusion: num_joints: found {num_joints}, expected 1 or more")
        self.rig = rig
        self.num_joints = num_joints
        self.settings = settings or FusionSettings()
        self._run: Callable[[Floats, Floats, Integers], Fused] = SlotKernel(
            rig, num_joints, self.settings
        )

    def warm_up(self) -> None:
        """Compile, or load from the cache, all that a slot needs; takes seconds the first time."""
        shape = (len(self.rig), 1, self.num_joints)
        for score in (0.0, 1.0):
            self.fuse_arrays(
                np.zeros((*shape, 2)), np.full(shape, score), np.ones(len(self.rig), np.int64)
            )

    def fuse(self, views: Mapping[int, Poses2D]) -> Fusion:
        """Fuse the views that arrived; cameras without a view are simply absent.

        Args:
            views: camera index to what it saw.

        Raises:
            InputError: on an unknown camera, another number of joints, or more than `MAX_POSES`.
        """
        for camera, view in views.items():
            if not 0 <= camera < len(self.rig):
                raise InputError(
                    f"fusion: view of camera {camera}: expected 0 to {len(self.rig) - 1}"
                )
            if view.scores.shape[1] != self.num_joints:
                raise InputError(
                    f"camera {self.rig.cameras[camera].camera_id}: found {view.scores.shape[1]} "
                    f"joints, expected {self.num_joints}"
                )
        counts = np.zeros(len(self.rig), np.int64)
        for camera, view in views.items():
            counts[camera] = len(view)
        _check_total(int(counts.sum()))
        shape = (len(self.rig), int(counts.max()), self.num_joints)
        keypoints = np.full((*shape, 2), np.nan)
        scores = np.zeros(shape)
        for camera, view in views.items():
            keypoints[camera, : len(view)] = view.keypoints_px
            scores[camera, : len(view)] = view.scores
        return self.fuse_arrays(keypoints, scores, counts)

    def fuse_arrays(
        self,
        keypoints_px: NDArray[np.floating],
        scores: NDArray[np.floating],
        counts: NDArray[np.integer],
    ) -> Fusion:
        """Fuse views that are already in one array: the fast path.

        Args:
            keypoints_px: `(num_cameras, max_persons, num_joints, 2)` pixels in the real images.
            scores: `(num_cameras, max_persons, num_joints)` in [0, 1]. A keypoint counts as missing
                where its score is NaN or below `MISSING_SCORE`, or its pixels are not finite; a
                score above 1 is 1.
            counts: `(num_cameras,)` people in each view; rows from there on are ignored.

        Raises:
            InputError: on a wrong shape or count, or more than `MAX_POSES` poses.
        """
        keypoints = np.ascontiguousarray(keypoints_px, dtype=np.float64)
        joint_scores = np.ascontiguousarray(scores, dtype=np.float64)
        people = np.ascontiguousarray(counts, dtype=np.int64)
        shape = joint_scores.shape
        if (
            len(shape) != 3
            or shape[0] != len(self.rig)
            or shape[2] != self.num_joints
            or keypoints.shape != (*shape, 2)
            or people.shape != shape[:1]
        ):
            raise InputError(
                f"fusion: found arrays of shapes {keypoints.shape}, {shape} and {people.shape}, "
                f"expected ({len(self.rig)}, max_persons, {self.num_joints}, 2), the same without "
                f"the 2, and ({len(self.rig)},)"
            )
        listed = people.tolist()
        if min(listed) < 0 or max(listed) > shape[1]:
            raise InputError(f"fusion: counts: found {listed}, expected 0 to {shape[1]} people")
        _check_total(sum(listed))
        joints, joint_scores, members, error = self._run(keypoints, joint_scores, people)
        return Fusion(People.unchecked(joints, joint_scores), members, error)


def _check_total(total: int) -> None:
    if total > MAX_POSES:
        raise InputError(f"fusion: found {total} poses in one slot, expected at most {MAX_POSES}")


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


@kernel
def weigh_groups(num_poses: int, workspace: Workspace) -> None:
    """Fill size and strength (sum of scores, in `STRENGTH_UNIT`) of all groups; 0 where is none."""
    labels, sizes = workspace.integers[LABEL], workspace.integers[SIZE]
    scores, strength = workspace.scores, workspace.strength
    for pose in range(num_poses):
        sizes[pose] = 0
        strength[pose] = 0.0
    for pose in range(num_poses):
        sizes[labels[pose]] += 1
        for joint in range(scores.shape[1]):
            strength[labels[pose]] += scores[pose, joint]
    for pose in range(num_poses):
        strength[pose] = math.floor(strength[pose] / STRENGTH_UNIT + 0.5)


@kernel
def dissolve_groups(
    num_poses: int,
    max_distance_m: float,
    cap_m: float,
    workspace: Workspace,
) -> None:
    """Change the labels; keep sizes and strengths (see `weigh_groups`) up to date.

    What `measure_pairs` and `group_poses` worked in is used up.
    """
    labels, sizes = workspace.integers[LABEL], workspace.integers[SIZE]
    homes, strength = workspace.integers[NEAREST], workspace.strength
    largest = 0
    for label in range(num_poses):
        largest = max(largest, sizes[label])
    changed = False
    weakest, last = -np.inf, -1
    while True:
        label = -1
        for other in range(num_poses):  # the next stronger group, of equals the next in order
            later = strength[other] > weakest or (strength[other] == weakest and other > last)
            later &= sizes[other] > 0
            if later and (label < 0 or strength[other] < strength[label]):
                label = other
        if label < 0:
            break
        weakest, last = strength[label], label
        if sizes[label] < 2 or sizes[label] >= largest:
            continue
        at_home = 0
        for pose in range(num_poses):
            if labels[pose] == label:
                homes[pose] = _find_home(pose, num_poses, max_distance_m, cap_m, workspace)
                if homes[pose] < 0:
                    break
                at_home += 1
        if at_home < sizes[label]:
            continue
        changed = True
        for pose in range(num_poses):
            if labels[pose] == label:
                labels[pose] = homes[pose]
                sizes[homes[pose]] += 1
                largest = max(largest, sizes[homes[pose]])
        sizes[label] = 0
    if changed:
        weigh_groups(num_poses, workspace)


@kernel
def _find_home(
    pose: int,
    num_poses: int,
    max_distance_m: float,
    cap_m: float,
    workspace: Workspace,
) -> int:
    """Return the group in which a pose is at home; -1 for none."""
    cameras, lanes = workspace.integers[CAMERA], workspace.lanes
    labels, sizes = workspace.integers[LABEL], workspace.integers[SIZE]
    group_sums, group_weights = workspace.distance, workspace.weights[0]
    for other in range(num_poses):
        group_sums[other] = 0.0
        group_weights[other] = 0.0
    for start in range(0, num_poses, LANES):
        measure_tile(pose, start // LANES, cap_m, workspace)
        for other in range(start, min(start + LANES, num_poses)):
            if cameras[other] == cameras[pose]:
                group_sums[labels[other]] = np.inf
            else:
                group_sums[labels[other]] += lanes[3 * LANES + other - start]
                group_weights[labels[other]] += lanes[4 * LANES + other - start]
    home = -1
    smallest = max_distance_m
    for other in range(num_poses):
        if sizes[other] > sizes[labels[pose]]:
            link = (group_sums[other] + PRIOR_JOINTS * cap_m) / (
                group_weights[other] + PRIOR_JOINTS
            )
            if link <= smallest:
                home = other
                smallest = link
    return home


@kernel
def group_poses(
    num_poses: int,
    max_distance_m: float,
    cap_m: float,
    workspace: Workspace,
) -> None:
    """Label each pose with the smallest pose index of its group.

    The sums and weights of `measure_pairs` are used up.
    """
    labels, nearest = workspace.integers[LABEL], workspace.integers[NEAREST]
    alive, distance = workspace.integers[ALIVE], workspace.distance
    num_alive = num_poses
    for pose in range(num_poses):
        labels[pose] = pose
        alive[pose] = pose
    for pose in range(num_poses):
        _find_nearest(pose, num_alive, cap_m, workspace)
    while True:
        first = -1
        smallest = np.inf
        for index in range(num_alive):
            if distance[alive[index]] < smallest:
                first = alive[index]
                smallest = distance[first]
        if first < 0 or smallest > max_distance_m:
            return
        second = nearest[first]
        first, second = min(first, second), max(first, second)
        for pose in range(num_poses):
            if labels[pose] == second:
                labels[pose] = first
        kept = 0
        for index in range(num_alive):
            if alive[index] != second:
                alive[kept] = alive[index]
                kept += 1
        num_alive = kept
        _merge(first, second, num_alive, cap_m, workspace)


@kernel
def _find_nearest(
    pose: int,
    num_alive: int,
    cap_m: float,
    workspace: Workspace,
) -> None:
    alive, nearest = workspace.integers[ALIVE], workspace.integers[NEAREST]
    sums, weights = workspace.sums, workspace.weights
    nearest[pose] = pose
    smallest = np.inf
    for index in range(num_alive):
        other = alive[index]
        link = (sums[pose, other] + PRIOR_JOINTS * cap_m) / (weights[pose, other] + PRIOR_JOINTS)
        if link < smallest:
            smallest = link
            nearest[pose] = other
    workspace.distance[pose] = smallest


@kernel
def _merge(
    first: int,
    second: int,
    num_alive: int,
    cap_m: float,
    workspace: Workspace,
) -> None:
    alive, nearest = workspace.integers[ALIVE], workspace.integers[NEAREST]
    sums, weights, distance = workspace.sums, workspace.weights, workspace.distance
    for index in range(num_alive):
        other = alive[index]
        if other == first:
            continue
        total = sums[first, other] + sums[second, other]
        weight = weights[first, other] + weights[second, other]
        sums[first, other] = sums[other, first] = total
        weights[first, other] = weights[other, first] = weight
        link = (total + PRIOR_JOINTS * cap_m) / (weight + PRIOR_JOINTS)
        if link < distance[other]:
            distance[other] = link
            nearest[other] = first
        elif nearest[other] == first or nearest[other] == second:
            _find_nearest(other, num_alive, cap_m, workspace)
    _find_nearest(first, num_alive, cap_m, workspace)
