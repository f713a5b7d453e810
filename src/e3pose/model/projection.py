"""Projection with its Jacobian, of many points and, compiled, of one."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel

MIN_DEPTH_M = 0.1  # nearer points are not seen
LEAST_DEPTH_M = 1e-6  # numerics: in place of smaller depths, so that no pixel is infinite


def project(points_m: Floats, projections: Floats) -> tuple[Floats, Floats, Floats]:
    """Project points and differentiate.

    Args:
        points_m: `(*batch, 3)`.
        projections: `(num_views, 3, 4)`.

    Returns:
        `(num_views, *batch, 2)` undistorted pixels, `(num_views, *batch)` depths, and
        `(num_views, *batch, 2, 3)` pixels by metres.
    """
    P = projections.reshape(len(projections), *(1,) * (points_m.ndim - 1), 3, 4)
    homogeneous = (P[..., :3] @ points_m[..., None])[..., 0] + P[..., 3]
    depth = homogeneous[..., 2]
    safe = np.where(np.abs(depth) < LEAST_DEPTH_M, LEAST_DEPTH_M, depth)[..., None]
    pixels = homogeneous[..., :2] / safe
    jacobian = (P[..., :2, :3] - pixels[..., None] * P[..., 2:, :3]) / safe[..., None]
    return pixels, depth, jacobian


@kernel
def shown_at(
    projection: Floats, x: float, y: float, z: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Return the depth of a point, its pixel, and the gradients of both pixel coordinates.

    Args:
        projection: `(3, 4)`.
        x: of the point in the world, metres, as `y` and `z`.
        y: see `x`.
        z: see `x`.

    Returns:
        `depth, u, v, u_x, u_y, u_z, v_x, v_y, v_z`: metres, pixels, and pixels per metre. Behind
        the camera, at a depth of 0 or less, the rest means nothing.
    """
    depth = projection[2, 0] * x + projection[2, 1] * y + projection[2, 2] * z + projection[2, 3]
    inverse = 1.0 / (depth if abs(depth) >= LEAST_DEPTH_M else LEAST_DEPTH_M)
    u = inverse * (
        projection[0, 0] * x + projection[0, 1] * y + projection[0, 2] * z + projection[0, 3]
    )
    v = inverse * (
        projection[1, 0] * x + projection[1, 1] * y + projection[1, 2] * z + projection[1, 3]
    )
    return (
        depth,
        u,
        v,
        (projection[0, 0] - u * projection[2, 0]) * inverse,
        (projection[0, 1] - u * projection[2, 1]) * inverse,
        (projection[0, 2] - u * projection[2, 2]) * inverse,
        (projection[1, 0] - v * projection[2, 0]) * inverse,
        (projection[1, 1] - v * projection[2, 1]) * inverse,
        (projection[1, 2] - v * projection[2, 2]) * inverse,
    )
