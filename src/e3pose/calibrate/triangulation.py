"""Points from views that may err grossly: linear first, then robust Gauss-Newton steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.geometry.camera import Rig

Floats = NDArray[np.float64]

STEPS = 6
OUTLIER_SIGMAS = 2.5  # residual at which a view's weight is halved
MIN_SPREAD = np.sin(np.radians(0.75))  # of rays: nearly parallel ones meet nowhere in particular
MIN_DEPTH = 1e-3


def place_points(rig: Rig, keypoints_px: Floats, sigma_px: Floats) -> Floats:
    """Triangulate points (Hartley-Zisserman 12.2, then least squares with Cauchy's weights).

    Args:
        rig: the cameras.
        keypoints_px: `(num_cameras, num_points, 2)` real pixels; NaN where not seen.
        sigma_px: `(num_cameras, num_points)` standard deviations.

    Returns:
        `(num_points, 3)` metres; NaN where fewer than two views saw the point, their rays are
        nearly parallel, or the point lies behind a camera that saw it.
    """
    ideal = np.stack([
        camera.normalise(pixels) for camera, pixels in zip(rig.cameras, keypoints_px, strict=True)
    ])  # fmt: skip
    focal = np.array([camera.K[0, 0] for camera in rig.cameras])[:, None]
    seen = np.isfinite(ideal[..., 0])
    precision = np.where(seen, focal / sigma_px, 0.0)
    uv = np.where(seen[..., None], ideal, 0.0)
    R = np.stack([camera.R for camera in rig.cameras])
    t = np.stack([camera.t for camera in rig.cameras])
    points = _linear(uv, precision, R, t)
    with np.errstate(all="ignore"):  # a point that runs away is refused at the end
        for _ in range(STEPS):
            points = points - _step(points, uv, precision, R, t)
        depths = np.einsum("cj,pj->cp", R[:, 2], points) + t[:, 2:]
        before = np.where(seen, depths > MIN_DEPTH, True).all(axis=0)
    good = before & np.isfinite(points).all(axis=-1) & _spread(points, seen, rig.centers_m)
    return np.where(good[:, None], points, np.nan)


def _linear(uv: Floats, precision: Floats, R: Floats, t: Floats) -> Floats:
    """Least squares of `u (R3 X + t3) = R1 X + t1` and the same for v, each view weighted."""
    rows = uv[..., None] * R[:, None, None, 2] - R[:, None, :2]  # (c, p, 2, 3)
    right = t[:, None, :2] - uv * t[:, None, 2:]
    weights = (precision / np.maximum(precision.max(axis=0), 1e-12))[..., None]
    rows, right = weights[..., None] * rows, weights * right
    normal = np.einsum("cpui,cpuj->pij", rows, rows)
    gradient = np.einsum("cpui,cpu->pi", rows, right)
    return _solve(normal, gradient)


def _step(points: Floats, uv: Floats, precision: Floats, R: Floats, t: Floats) -> Floats:
    in_camera = np.einsum("cij,pj->cpi", R, points) + t[:, None]
    depth = np.maximum(in_camera[..., 2], MIN_DEPTH)
    projected = in_camera[..., :2] / depth[..., None]
    residual = precision[..., None] * (projected - uv)
    weights = 1.0 / (1.0 + (residual**2).sum(axis=-1) / OUTLIER_SIGMAS**2)
    slope = (R[:, None, :2] - projected[..., None] * R[:, None, None, 2]) / depth[..., None, None]
    slope = precision[..., None, None] * slope
    normal = np.einsum("cp,cpui,cpuj->pij", weights, slope, slope)
    gradient = np.einsum("cp,cpui,cpu->pi", weights, slope, residual)
    return _solve(normal, gradient)


def _solve(normal: Floats, gradient: Floats) -> Floats:
    """Solve stacks of three equations, damped so that a point seen once stays finite."""
    trace = np.trace(normal, axis1=-2, axis2=-1)
    damped = normal + (1e-9 * trace + 1e-30)[..., None, None] * np.eye(3)
    return np.asarray(np.linalg.solve(np.nan_to_num(damped), gradient[..., None])[..., 0])


def _spread(points: Floats, seen: NDArray[np.bool_], centers_m: Floats) -> NDArray[np.bool_]:
    """Return whether the rays of each point come from directions that differ."""
    rays = points[None] - centers_m[:, None]
    rays = rays / np.maximum(np.linalg.norm(rays, axis=-1, keepdims=True), 1e-9)
    count = seen.sum(axis=0)
    mean = np.where(seen[..., None], rays, 0.0).sum(axis=0) / np.maximum(count, 1)[:, None]
    with np.errstate(invalid="ignore"):
        spread = np.sqrt(np.maximum(1 - (mean**2).sum(axis=-1), 0.0))
        return np.asarray((count >= 2) & (spread > MIN_SPREAD))
