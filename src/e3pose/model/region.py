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


def in_polygon(
    places_m: NDArray[np.floating], corners_m: NDArray[np.floating]
) -> NDArray[np.bool_]:
    """Return which places lie in a polygon: those from which a ray crosses its sides an odd time.

    Args:
        places_m: `(num_places, 2)` metres; NaN lies nowhere.
        corners_m: `(num_corners, 2)` metres, in order around it.
    """
    (x0, y0), (x1, y1) = corners_m.T, np.roll(corners_m, -1, axis=0).T
    x, y = places_m[:, :1], places_m[:, 1:]
    spans = (y0 > y) != (y1 > y)
    rise = np.where(y1 == y0, 1.0, y1 - y0)  # a level side spans nothing
    crossing_x = x0 + (y - y0) * (x1 - x0) / rise
    return np.asarray((spans & (x < crossing_x)).sum(axis=1) % 2 == 1)


def distance_m(
    places_m: NDArray[np.floating], corners_m: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Return `(num_places,)` metres from places to the nearest side of a polygon.

    Args:
        places_m: `(num_places, 2)` metres; the distance of NaN is NaN.
        corners_m: `(num_corners, 2)` metres, in order around it.
    """
    along = np.roll(corners_m, -1, axis=0) - corners_m
    to = places_m[:, None] - corners_m
    length2 = np.maximum((along**2).sum(axis=-1), 1e-12)
    share = np.clip((to * along).sum(axis=-1) / length2, 0.0, 1.0)
    apart = to - share[..., None] * along
    return np.asarray(np.sqrt((apart**2).sum(axis=-1)).min(axis=1))
