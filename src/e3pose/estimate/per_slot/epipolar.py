"""Matching of 2D poses across views by epipolar distance, camera by camera.

The poses of the first camera are the first candidates. Then, in the order of the rig, the poses of
each camera are assigned to candidates, at most one to each, and what is left over begins a
candidate of its own. Two matchers assign:

- `epipolar` as the E3Pose paper words it: greedily, the smallest cost first, up to a threshold;
- `tanke-gall` as Tanke and Gall published it (Iterative Greedy Matching for 3D Human Pose Tracking
  from Multiple Views, 2019, and their code): poses of a mean score up to 0.30 are dropped, each
  camera's poses are assigned at the least total cost, and an assignment is refused if any member
  of the candidate with a mean score above 0.5 is farther than the threshold.

With x the keypoint of a joint in a view, x' that in another, F the fundamental matrix for which
x'^T F x = 0, and d the distance of a point from a line in pixels, two poses with the shared joints
J are apart by

    D(p, p') = 1/|J| sum_J (d(x', F x) + d(x, F^T x')) / 2

and a pose costs a candidate the mean of D over the poses that the candidate has so far. Two poses
without a shared joint say nothing; they do not count in that mean. Scores do not count in costs.

The order of the cameras matters, as in the paper: `docs/decisions/0001-matching.md` says why the
rest of the project matches otherwise.
"""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.per_slot.assign import assign
from e3pose.estimate.per_slot.workspace import CAMERA, LABEL, Workspace
from e3pose.model.camera import Rig

# Of Tanke and Gall, of the mean score of a pose.
DROPPED_SCORE, STRONG_SCORE = 0.3, 0.5  # definition: as published
FAR_PX = 1e6  # numerics: costs more than any assignment that is possible


def fundamental_matrices(rig: Rig) -> Floats:
    """Return `(num_cameras, num_cameras, 3, 3)`: F of pixels of the first, lines in the second.

    Of undistorted pixels. A matrix is 0 where two cameras share their centre: then there are no
    epipolar lines.
    """
    centers = np.concatenate([rig.centers_m, np.ones((len(rig), 1))], axis=1)
    epipoles = np.einsum("bij,aj->abi", rig.projections, centers)  # of camera a in image b
    cross = np.zeros((len(rig), len(rig), 3, 3))
    for row, column, axis, sign in (
        (0, 1, 2, -1), (0, 2, 1, 1), (1, 0, 2, 1), (1, 2, 0, -1), (2, 0, 1, -1), (2, 1, 0, 1),
    ):  # fmt: skip
        cross[:, :, row, column] = sign * epipoles[:, :, axis]
    found = np.einsum("abij,bjk,akl->abil", cross, rig.projections, np.linalg.pinv(rig.projections))
    norm = np.linalg.norm(found, axis=(-2, -1), keepdims=True)
    apart = np.linalg.norm(rig.centers_m[:, None] - rig.centers_m[None], axis=-1) > 1e-9
    return np.where(apart[..., None, None], found / np.maximum(norm, 1e-300), 0.0)


@kernel
def match_epipolar(
    num_poses: int, fundamentals: Floats, max_distance_px: float, workspace: Workspace
) -> None:
    """Label each pose with the first pose index of its candidate.

    Args:
        num_poses: of all views, camera after camera.
        fundamentals: those of `fundamental_matrices`.
        max_distance_px: the most that a pose may cost the candidate it is assigned to.
        workspace: with the poses of the slot; its sums are used up.
    """
    labels, costs = workspace.integers[LABEL], workspace.sums  # candidate by pose
    start = 0
    while start < num_poses:
        stop = _each_alone(start, num_poses, workspace)
        for candidate in range(start):
            for pose in range(start, stop):
                costs[candidate, pose] = np.inf
                if labels[candidate] == candidate:
                    costs[candidate, pose] = _cost(candidate, pose, start, fundamentals, workspace)
        while True:
            best, chosen, smallest = -1, -1, max_distance_px
            for candidate in range(start):
                for pose in range(start, stop):
                    if costs[candidate, pose] < smallest:
                        best, chosen, smallest = candidate, pose, costs[candidate, pose]
            if best < 0:
                break
            labels[chosen] = best
            for candidate in range(start):
                costs[candidate, chosen] = np.inf
            for pose in range(start, stop):
                costs[best, pose] = np.inf
        start = stop


@kernel
def match_tanke_gall(
    num_poses: int, fundamentals: Floats, max_distance_px: float, workspace: Workspace
) -> None:
    """Label poses as `match_epipolar` does; a dropped pose is alone. Arguments are its own."""
    labels, costs = workspace.integers[LABEL], workspace.sums
    reals, integers = np.empty((3, num_poses)), np.empty((5, num_poses), np.int64)
    flags, believed = np.empty((2, num_poses), np.bool_), np.empty(num_poses)
    rows, columns = np.empty(num_poses, np.int64), np.empty(num_poses, np.int64)
    for pose in range(num_poses):
        believed[pose] = _mean_score(workspace.scores[pose])
    start = 0
    while start < num_poses:
        stop = _each_alone(start, num_poses, workspace)
        num_rows = num_columns = 0
        for pose in range(start, stop):
            if believed[pose] > DROPPED_SCORE:
                columns[num_columns] = pose
                num_columns += 1
        for candidate in range(start):
            if labels[candidate] == candidate and believed[candidate] > DROPPED_SCORE:
                rows[num_rows] = candidate
                num_rows += 1
        for row in range(num_rows):
            for column in range(num_columns):
                apart = _cost(rows[row], columns[column], start, fundamentals, workspace)
                costs[row, column] = min(FAR_PX, apart)
        if num_rows > 0 and num_columns > 0:
            assign(costs, num_rows, num_columns, reals, integers, flags)
            for row in range(num_rows):
                column = integers[0, row]
                if column >= 0 and not _vetoed(
                    rows[row],
                    columns[column],
                    start,
                    fundamentals,
                    max_distance_px,
                    believed,
                    workspace,
                ):
                    labels[columns[column]] = rows[row]
        start = stop


@kernel
def _each_alone(start: int, num_poses: int, workspace: Workspace) -> int:
    """Make each pose of the view that begins at `start` a candidate; return where it ends."""
    cameras, labels = workspace.integers[CAMERA], workspace.integers[LABEL]
    stop = start
    while stop < num_poses and cameras[stop] == cameras[start]:
        labels[stop] = stop
        stop += 1
    return stop


@kernel
def _mean_score(scores: Floats) -> float:
    """Return the mean score of the joints that are seen."""
    total, count = 0.0, 0
    for joint in range(len(scores)):
        if scores[joint] > 0:
            total += scores[joint]
            count += 1
    return total / count if count > 0 else 0.0


@kernel
def _vetoed(
    candidate: int,
    pose: int,
    stop: int,
    fundamentals: Floats,
    max_distance_px: float,
    believed: Floats,
    workspace: Workspace,
) -> bool:
    """Return whether a strong member of a candidate is too far from a pose."""
    labels = workspace.integers[LABEL]
    for member in range(candidate, stop):
        if labels[member] == candidate and believed[member] > STRONG_SCORE:
            apart = _distance(member, pose, fundamentals, workspace)
            if not apart <= max_distance_px:
                return True
    return False


@kernel
def _cost(
    candidate: int,
    pose: int,
    stop: int,
    fundamentals: Floats,
    workspace: Workspace,
) -> float:
    """Return the mean distance of a pose from a candidate's poses before `stop`."""
    labels = workspace.integers[LABEL]
    total, count = 0.0, 0
    for member in range(candidate, stop):
        if labels[member] != candidate:
            continue
        apart = _distance(member, pose, fundamentals, workspace)
        if math.isfinite(apart):
            total += apart
            count += 1
    return total / count if count > 0 else np.inf


@kernel
def _distance(
    member: int,
    pose: int,
    fundamentals: Floats,
    workspace: Workspace,
) -> float:
    """Return D of two poses in pixels; inf without a shared joint, or without epipolar lines."""
    cameras, pixels, scores = workspace.integers[CAMERA], workspace.pixels, workspace.scores
    forward = fundamentals[cameras[member], cameras[pose]]
    backward = fundamentals[cameras[pose], cameras[member]]
    apart, shared = 0.0, 0
    for joint in range(scores.shape[1]):
        if scores[member, joint] > 0 and scores[pose, joint] > 0:
            apart += 0.5 * _line_distance(forward, pixels[member, joint], pixels[pose, joint])
            apart += 0.5 * _line_distance(backward, pixels[pose, joint], pixels[member, joint])
            shared += 1
    return apart / shared if shared > 0 else np.inf


@kernel
def _line_distance(fundamental: Floats, point: Floats, other: Floats) -> float:
    """Return the distance of `other` from the epipolar line of `point`, in pixels."""
    u, v = point[0], point[1]
    a = fundamental[0, 0] * u + fundamental[0, 1] * v + fundamental[0, 2]
    b = fundamental[1, 0] * u + fundamental[1, 1] * v + fundamental[1, 2]
    c = fundamental[2, 0] * u + fundamental[2, 1] * v + fundamental[2, 2]
    length = math.sqrt(a * a + b * b)
    if length <= 0.0:
        return np.inf
    return float(abs(a * other[0] + b * other[1] + c)) / length
