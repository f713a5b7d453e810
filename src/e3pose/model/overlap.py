"""Overlap of the views of cameras."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.camera import Rig

OVERLAP_DEPTHS_M = np.arange(1.0, 9.0, 0.5)
PERSON_M = 2.0  # up to which height people are seen


@lru_cache(maxsize=64)
def overlap(rig: Rig) -> Floats:
    """Return `(num_cameras, num_cameras)`: shares of a view (row) that another sees too.

    The share of points along the rays of its image, at heights of people; 0 on the diagonal.
    """
    share = np.zeros((len(rig), len(rig)))
    for row, camera in enumerate(rig.cameras):
        width, height = camera.image_size
        u, v = np.meshgrid(np.linspace(0.1, 0.9, 7) * width, np.linspace(0.1, 0.9, 5) * height)
        rays = camera.rays(np.stack([u.ravel(), v.ravel()], axis=-1))
        points = camera.center_m + rays[:, None] * OVERLAP_DEPTHS_M[:, None]
        points = points[(points[..., 2] > 0) & (points[..., 2] < PERSON_M)]
        if len(points):
            share[row] = [other.sees(points).mean() for other in rig.cameras]
    np.fill_diagonal(share, 0.0)
    return share
