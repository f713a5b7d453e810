"""Extrinsics from corresponding points: a ball, or the joints of matched people.

One pair of cameras begins, by its essential matrix; the points that it triangulates place a third
camera, and so on, bundle adjustment after each. The scale is whatever the first pair's was.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.calibrate.bundle import Adjusted, AdjustOptions, adjust_points
from e3pose.calibrate.essential import RelativePose, relative_pose
from e3pose.calibrate.moved_cameras import Diverged, placed
from e3pose.calibrate.triangulation import place_points
from e3pose.model.camera import Rig

TOLERANCE_SIGMAS = 3.0  # to an epipolar line, for RANSAC
OUTLIER_SIGMAS = 2.5  # Cauchy's loss in bundle adjustment
MIN_SHARED = 15  # placed points that a new camera must see
MOST_POINTS = 3000  # in bundle adjustment; those of most views are preferred


@dataclass(frozen=True, slots=True, eq=False)
class PointRig:
    """A rig solved from points.

    Attributes:
        adjusted: cameras, points and residuals in standard deviations.
        used: `(num_used,)` which points those are.
        placed: `(num_cameras,)` which cameras could be placed; the others are where they were.
        lenses: what was expected of lenses, as `AdjustOptions` has it.
    """

    adjusted: Adjusted
    used: NDArray[np.int64]
    placed: NDArray[np.bool_]
    lenses: Floats | None


def pair_poses(
    rig: Rig, keypoints_px: Floats, sigma_px: Floats
) -> dict[tuple[int, int], RelativePose]:
    """Return the relative pose of every pair of cameras that shares enough points.

    Args:
        rig: lenses.
        keypoints_px: `(num_cameras, num_points, 2)` real pixels; NaN where not seen.
        sigma_px: `(num_cameras, num_points)` standard deviations.
    """
    ideal = [
        camera.normalise(pixels) for camera, pixels in zip(rig.cameras, keypoints_px, strict=True)
    ]
    poses = {}
    for a in range(len(rig)):
        for b in range(a + 1, len(rig)):
            both = np.isfinite(ideal[a][:, 0]) & np.isfinite(ideal[b][:, 0])
            if not both.any():
                continue
            sigma = np.median(
                [np.median(sigma_px[i][both]) / rig.cameras[i].K[0, 0] for i in (a, b)]
            )
            pose = relative_pose(ideal[a][both], ideal[b][both], TOLERANCE_SIGMAS * float(sigma))
            if pose is not None:
                poses[a, b] = pose
    return poses


def solve_points(
    rig: Rig,
    keypoints_px: Floats,
    sigma_px: Floats,
    poses: dict[tuple[int, int], RelativePose],
    lenses: Floats | None = None,
) -> PointRig | None:
    """Place cameras by points, from relative poses; None if no pair can begin.

    Args:
        rig: lenses.
        keypoints_px: `(num_cameras, num_points, 2)` real pixels; NaN where not seen.
        sigma_px: `(num_cameras, num_points)` standard deviations.
        poses: of pairs of cameras, as `pair_poses` finds them.
        lenses: what to expect of lenses, as `AdjustOptions` has it.
    """
    if not poses:
        return None
    order = sorted(poses, key=lambda pair: -_strength(poses[pair]))
    best: PointRig | None = None
    for pair in order[:3]:
        found = _grow(rig, keypoints_px, sigma_px, pair, poses[pair], lenses)
        if found is not None and (best is None or _better(found, best)):
            best = found
        if best is not None and best.placed.all() and _inlier_share(best) > 0.5:
            break
    return best


def _strength(pose: RelativePose) -> float:
    """Many inliers, at angles that fix depth: 90 degrees are best."""
    return float(pose.inliers.sum()) * min(float(np.sin(pose.parallax)), 0.5)


def _better(one: PointRig, other: PointRig) -> bool:
    ours, theirs = int(one.placed.sum()), int(other.placed.sum())
    return (ours, _inlier_share(one)) > (theirs, _inlier_share(other))


def _inlier_share(found: PointRig) -> float:
    """Return the share of observations that the rig explains within three deviations."""
    size = np.linalg.norm(found.adjusted.residuals, axis=-1)
    return float(np.mean(size[np.isfinite(size)] < 3.0))


def _grow(
    rig: Rig,
    keypoints_px: Floats,
    sigma_px: Floats,
    pair: tuple[int, int],
    pose: RelativePose,
    lenses: Floats | None,
) -> PointRig | None:
    first, second = pair
    cameras = list(rig.cameras)
    cameras[first] = placed(cameras[first], np.eye(3), np.zeros(3))
    cameras[second] = placed(cameras[second], pose.R, pose.t)
    current, done = Rig(tuple(cameras)), np.zeros(len(rig), dtype=bool)
    done[[first, second]] = True
    while True:
        solved = adjust_all(current, keypoints_px, sigma_px, done, lenses, max_steps=25)
        if solved is None:
            return None
        current, points, used = solved.adjusted.rig, solved.adjusted.blocks, solved.used
        candidate = _next_camera(current, keypoints_px[:, used], solved, done)
        if candidate is None:
            return solved
        index, R, t = candidate
        cameras = list(current.cameras)
        cameras[index] = placed(cameras[index], R, t)
        current = Rig(tuple(cameras))
        done[index] = True
        del points


def adjust_all(
    rig: Rig,
    keypoints_px: Floats,
    sigma_px: Floats,
    done: NDArray[np.bool_],
    lenses: Floats | None = None,
    max_steps: int = 60,
    most_points: int = MOST_POINTS,
) -> PointRig | None:
    """Triangulate points in the cameras that are placed, and adjust both.

    Args:
        rig: the cameras.
        keypoints_px: `(num_cameras, num_points, 2)` real pixels; NaN where not seen.
        sigma_px: `(num_cameras, num_points)` standard deviations.
        done: `(num_cameras,)` which cameras are placed.
        lenses: as for `solve_points`.
        max_steps: of the adjustment.
        most_points: to adjust with.

    Returns:
        None where too few points are seen by two cameras, or a camera ends kilometres away.
    """
    pixels = np.where(done[:, None, None], keypoints_px, np.nan)
    points = place_points(rig, pixels, sigma_px)
    there = np.isfinite(points[:, 0])
    views = np.isfinite(pixels[..., 0]).sum(axis=0)
    used = np.flatnonzero(there & (views >= 2))
    if len(used) < MIN_SHARED:
        return None
    used = subsampled(used, views[used], most_points)
    free = done.copy()
    free[int(np.flatnonzero(done)[0])] = False
    if lenses is not None:
        lenses = np.where(done[:, None, None, None] & done[:, None], lenses, 0.0)
    try:
        adjusted = adjust_points(
            rig, points[used], pixels[:, used], sigma_px[:, used],
            AdjustOptions(OUTLIER_SIGMAS, free, lenses, max_steps),
        )  # fmt: skip
    except Diverged:
        return None
    return PointRig(adjusted, used, done.copy(), lenses)


def subsampled(used: NDArray[np.int64], views: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return so many of the points `used`, evenly; those of three or more `views` count double."""
    if len(used) <= most:
        return used
    many, few = used[views >= 3], used[views < 3]
    from_many = min(len(many), max(most - len(few), 2 * most // 3))
    from_few = min(len(few), most - from_many)
    picked = [
        group[np.linspace(0, len(group) - 1, number).round().astype(int)] if number else group[:0]
        for group, number in ((many, from_many), (few, from_few))
    ]
    return np.asarray(np.unique(np.concatenate(picked)))


def _next_camera(
    rig: Rig, keypoints_px: Floats, solved: PointRig, done: NDArray[np.bool_]
) -> tuple[int, Floats, Floats] | None:
    """Place the camera that sees most placed points, by RANSAC over them."""
    import cv2

    weights = solved.adjusted.weights[..., 0]
    trusted = (weights > 0.4).sum(axis=0) >= 2
    counts = [
        0 if done[i] else int((np.isfinite(pixels[:, 0]) & trusted).sum())
        for i, pixels in enumerate(keypoints_px)
    ]
    for index in np.argsort(-np.array(counts), kind="stable").tolist():
        if counts[index] < MIN_SHARED:
            return None
        camera = rig.cameras[index]
        ideal = camera.normalise(keypoints_px[index])
        both = np.isfinite(ideal[:, 0]) & trusted
        cv2.setRNGSeed(7)
        found, turn, shift, inliers = cv2.solvePnPRansac(
            solved.adjusted.blocks[both], ideal[both], np.eye(3), None, iterationsCount=3000,
            reprojectionError=0.025, confidence=0.9999, flags=cv2.SOLVEPNP_SQPNP,
        )  # fmt: skip
        if found and inliers is not None and len(inliers) >= max(MIN_SHARED, 0.3 * counts[index]):
            return index, np.asarray(cv2.Rodrigues(turn)[0]), np.asarray(shift[:, 0])
    return None
