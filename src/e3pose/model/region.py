"""Regions of the floor: whether people stand in a rectangle or a polygon."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def middles_m(joints_m: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return where people stand: the mean of their known joints on the floor.

    Args:
        joints_m: `(*batch, num_joints, 3)` world metres, NaN where missing.

    Returns:
        `(*batch, 2)` metres; NaN of somebody without a joint.
    """
    known = np.isfinite(joints_m).all(axis=-1)
    total = np.where(known[..., None], joints_m, 0.0).sum(axis=-2, dtype=np.float64)[..., :2]
    count = known.sum(axis=-1)[..., None]
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def in_rectangle(
    places_m: NDArray[np.floating], region_m: tuple[float, float, float, float]
) -> NDArray[np.bool_]:
    """Return which places lie between two corners.

    Args:
        places_m: `(*batch, 2)` metres; NaN lies nowhere.
        region_m: x and y of one corner, x and y of the other.
    """
    x0, y0, x1, y1 = region_m
    low, high = np.minimum([x0, y0], [x1, y1]), np.maximum([x0, y0], [x1, y1])
    return np.asarray(((places_m >= low) & (places_m <= high)).all(axis=-1))
