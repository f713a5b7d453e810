"""Greedy matching of 2D poses across views by epipolar distance, as in the paper.

The method of Tanke and Gall (2019), which the paper names. The poses of the first camera are the
first candidates. Then, camera by camera in the order of the rig, poses are assigned to candidates,
the smallest cost first, up to a threshold; each candidate gets at most one pose of a view. What is
left over begins a candidate of its own.

With x the keypoint of a joint in a view, x' that in another, F the fundamental matrix for which
x'^T F x = 0, and d the distance of a point from a line in pixels, two poses with the shared joints
J are apart by

    D(p, p') = 1/|J| sum_J (d(x', F x) + d(x, F^T x')) / 2

and a pose costs a candidate the mean of D over the poses that the candidate has so far. Two poses
without a shared joint say nothing; they do not count in that mean. Scores do not count either.

The order of the cameras matters, as in the paper: `docs/decisions/0001-matching.md` says why the
rest of the project matches otherwise.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.geometry.camera import Rig
from e3pose.runtime.kernel import kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


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
    num_poses: int,
    cameras: Integers,
    pixels: Floats,
    scores: Floats,
    fundamentals: Floats,
    max_distance_px: float,
    labels: Integers,
    costs: Floats,
) -> None:
    """Fill `labels` with the first pose index of each pose's candidate.

    Args:
        num_poses: of all views, camera after camera.
        cameras: `(num_poses,)` camera of each pose.
        pixels: `(num_poses, num_joints, 2)` undistorted.
        scores: `(num_poses, num_joints)`; 0 where not seen.
        fundamentals: those of `fundamental_matrices`.
        max_distance_px: the most that a pose may cost the candidate it is assigned to.
        labels: `(num_poses,)`, filled.
        costs: `(num_poses, num_poses)` scratch: candidate by pose.
    """
    start = 0
    while start < num_poses:
        stop = start
        while stop < num_poses and cameras[stop] == cameras[start]:
            labels[stop] = stop
            stop += 1
        for candidate in range(start):
            for pose in range(start, stop):
                costs[candidate, pose] = np.inf
                if labels[candidate] == candidate:
                    costs[candidate, pose] = _cost(
                        candidate, pose, start, labels, cameras, pixels, scores, fundamentals
                    )
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
def _cost(
    candidate: int,
    pose: int,
    stop: int,
    labels: Integers,
    cameras: Integers,
    pixels: Floats,
    scores: Floats,
    fundamentals: Floats,
) -> float:
    """Return the mean distance of a pose from those of a candidate before `stop`."""
    total, count = 0.0, 0
    for member in range(candidate, stop):
        if labels[member] != candidate:
            continue
        forward = fundamentals[cameras[member], cameras[pose]]
        backward = fundamentals[cameras[pose], cameras[member]]
        apart, shared = 0.0, 0
        for joint in range(scores.shape[1]):
            if scores[member, joint] > 0 and scores[pose, joint] > 0:
                apart += 0.5 * _line_distance(forward, pixels[member, joint], pixels[pose, joint])
                apart += 0.5 * _line_distance(backward, pixels[pose, joint], pixels[member, joint])
                shared += 1
        if shared > 0 and math.isfinite(apart):
            total += apart / shared
            count += 1
    return total / count if count > 0 else np.inf


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
