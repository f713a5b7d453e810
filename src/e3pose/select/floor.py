"""The visible floor: where people can be, and which cameras would show them."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats
from e3pose.estimate.filter import blindness
from e3pose.model.camera import Rig

# tuned: m | first guess: people's own size; floor around the cameras; how far cameras show people |
#   not measured
CELL_M, MARGIN_M, FAR_M = 0.5, 2.0, 12.0
MOST_CELLS = 4000  # capacity: of a site; a larger one has larger cells
HEIGHTS_M = (0.1, 0.5, 0.9, 1.3, 1.7)  # definition: of somebody who stands in a cell
# tuned: share of these heights | first guess: a camera sees the person | not measured
SEEN_SHARE = 0.6
MOST_SURE = 0.999  # numerics


@lru_cache(maxsize=64)
def seen_floor(rig: Rig) -> tuple[Floats, Floats]:
    """Return the floor cells in which two cameras would see a standing person.

    Nobody is estimated in others.

    Returns:
        `(num_cells, 2)` metres, their middles, and `(num_cameras, num_cells)` 1 where a camera
        sees somebody who stands in a cell, else 0. Walls are not known.
    """
    places_m = rig.centers_m[:, :2]
    low, high = places_m.min(axis=0) - MARGIN_M, places_m.max(axis=0) + MARGIN_M
    cell_m = max(CELL_M, float(np.sqrt(np.prod(high - low) / MOST_CELLS)))
    x, y = np.meshgrid(*(np.arange(a, b, cell_m) for a, b in zip(low, high, strict=True)))
    cells_m = np.stack([x.ravel(), y.ravel()], axis=-1)
    heights_m = np.tile(HEIGHTS_M, len(cells_m))[:, None]
    points_m = np.concatenate([np.repeat(cells_m, len(HEIGHTS_M), axis=0), heights_m], axis=1)
    shape = (len(cells_m), len(HEIGHTS_M))
    inside = np.stack([c.sees(points_m).reshape(shape).mean(axis=1) for c in rig.cameras])
    near = np.linalg.norm(cells_m - places_m[:, None], axis=-1) < FAR_M
    seen = ((inside >= SEEN_SHARE) & near).astype(np.float64)
    two = seen.sum(axis=0) >= 2
    return cells_m[two], np.asarray(seen[:, two])


class _Corners(NamedTuple):
    """The cells of a detection map around each floor cell, with their detection rates."""

    columns: NDArray[np.int64]  # (4, num_cells)
    rows: NDArray[np.int64]  # (4, num_cells)
    weights: Floats  # (4, num_cells)
    free: Floats  # (num_cameras, num_cells) that nothing stands in the way


@lru_cache(maxsize=8)
def _corners(rig: Rig) -> _Corners:
    cells_m, _ = seen_floor(rig)
    at = (cells_m - blindness.corner_m(rig)) / blindness.CELL_M - 0.5
    at = np.clip(at, 0.0, blindness.LAST)
    low = np.floor(at).astype(np.int64)
    right, up = (at - low).T
    far_m = np.linalg.norm(cells_m - rig.centers_m[:, None, :2], axis=-1)
    return _Corners(
        columns=low[:, 0] + np.array([[0], [0], [1], [1]]),
        rows=low[:, 1] + np.array([[0], [1], [0], [1]]),
        weights=np.stack([(1 - right) * (1 - up), (1 - right) * up, right * (1 - up), right * up]),
        free=np.exp(-far_m / FAR_M),  # a wall is likelier on a longer way
    )


def sights(rig: Rig, detection_map: Floats | None) -> Floats:
    """Return `(num_cameras, num_cells)` how likely each camera shows who is in a cell of the floor.

    Where people were, looks tell. Elsewhere the farther a cell the likelier something hides it.

    Args:
        rig: the cameras.
        detection_map: as in `Outlook`; None where nothing is known.
    """
    _, seen = seen_floor(rig)
    corners = _corners(rig)
    if detection_map is None:
        return np.asarray(seen * corners.free * MOST_SURE)
    there = detection_map[:, corners.columns, corners.rows]
    looks, shown = np.einsum("kn,cknv->vcn", corners.weights, there)
    known = blindness.PRIOR_VIEWS * blindness.PLAIN * corners.free + shown
    rate = known / (looks + blindness.PRIOR_VIEWS) / blindness.PLAIN
    return np.asarray(seen * np.clip(rate, 0.0, 1.0) * MOST_SURE)


def showing(sight: Floats, sets: Flags) -> tuple[Floats, Floats]:
    """Return how likely at least one, and at least two, of sets of cameras show who is in a cell.

    Args:
        sight: `(num_cameras, num_cells)` of `sights`.
        sets: `(num_sets, num_cameras)`.

    Returns:
        Twice `(num_sets, num_cells)`.
    """
    none = np.exp(sets @ np.log1p(-sight))
    return np.asarray(1 - none), np.asarray(1 - none * (1 + sets @ (sight / (1 - sight))))
