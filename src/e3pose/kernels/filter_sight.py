"""Where a view shows a point, and how that moves with the point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.kernels.compile import kernel

Floats = NDArray[np.float64]


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
    inverse = 1.0 / depth
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
