"""Projection with its Jacobian."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats

MIN_DEPTH_M = 0.1  # nearer points are not seen


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
    safe = np.where(np.abs(depth) < 1e-6, 1e-6, depth)[..., None]
    pixels = homogeneous[..., :2] / safe
    jacobian = (P[..., :2, :3] - pixels[..., None] * P[..., 2:, :3]) / safe[..., None]
    return pixels, depth, jacobian
