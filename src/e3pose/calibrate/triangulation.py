"""Triangulate many points at once, with the estimator's weighted DLT and robust Gauss-Newton."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.estimate.per_slot.triangulate import refine_person, triangulate_person
from e3pose.model.camera import Rig

STEPS = 6
# The kernels have bounds in metres; a rig without a scale yet is brought to that of a room.
ROOM_RADIUS_M = 3.0
MIN_SPREAD = np.sin(np.radians(0.75))  # of rays: nearly parallel ones meet nowhere in particular


def place_points(rig: Rig, keypoints_px: Floats, sigma_px: Floats) -> Floats:
    """Triangulate points (Hartley-Zisserman 12.2, then least squares with Cauchy's weights).

    Args:
        rig: the cameras, in any unit of length.
        keypoints_px: `(num_cameras, num_points, 2)` real pixels; NaN where not seen.
        sigma_px: `(num_cameras, num_points)` standard deviations.

    Returns:
        `(num_points, 3)` in the rig's unit; NaN where fewer than two views saw the point, their
        rays are nearly parallel, or the point lies behind a camera that saw it.
    """
    pixels = np.stack([
        camera.undistort(points) for camera, points in zip(rig.cameras, keypoints_px, strict=True)
    ])  # fmt: skip
    seen = np.isfinite(pixels[..., 0])
    precisions = np.where(seen, 1 / sigma_px, 0.0)
    scores = precisions / np.maximum(precisions.max(axis=0), 1e-12)
    pixels[~seen] = 0.0
    radius = np.linalg.norm(rig.centers_m - rig.centers_m.mean(axis=0), axis=1).max()
    scale = ROOM_RADIUS_M / max(float(radius), 1e-9)
    projections = rig.projections / [scale, scale, scale, 1.0]
    views, points = np.arange(len(rig)), np.empty((pixels.shape[1], 3))
    triangulate_person(views, views, pixels, scores, projections, np.empty((4, 4, 4)), points)
    refine_person(views, views, pixels, precisions, projections, STEPS, True, points)
    points /= scale
    return np.where(_spread(points, seen, rig.centers_m)[:, None], points, np.nan)


def _spread(points: Floats, seen: NDArray[np.bool_], centers_m: Floats) -> NDArray[np.bool_]:
    """Return whether the rays of each point come from directions that differ."""
    rays = points[None] - centers_m[:, None]
    rays = rays / np.maximum(np.linalg.norm(rays, axis=-1, keepdims=True), 1e-9)
    count = seen.sum(axis=0)
    mean = np.where(seen[..., None], rays, 0.0).sum(axis=0) / np.maximum(count, 1)[:, None]
    with np.errstate(invalid="ignore"):
        spread = np.sqrt(np.maximum(1 - (mean**2).sum(axis=-1), 0.0))
        return np.asarray((count >= 2) & (spread > MIN_SPREAD))
