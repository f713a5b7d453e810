"""The floor that cameras see, where newcomers can appear."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.model.camera import Rig

# tuned: m | first guess: people's own size; floor around the cameras; how far cameras show people |
#   not measured
CELL_M, MARGIN_M, FAR_M = 0.5, 2.0, 12.0
MOST_CELLS = 4000  # capacity: of a site; a larger one has larger cells
HEIGHTS_M = (0.1, 0.5, 0.9, 1.3, 1.7)  # definition: of somebody who stands in a cell
# tuned: share of these heights | first guess: a camera sees the person | not measured
SEEN_SHARE = 0.6


@lru_cache(maxsize=64)
def seen_floor(rig: Rig) -> tuple[Floats, Floats]:
    """Return the cells of the floor in which two cameras see somebody who stands there.

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


def watched(looks: Floats, weights: Floats) -> Floats:
    """Return `(num_sets,)` share of the floor that sets of cameras watch.

    A cell that one camera sees counts half: somebody is noticed there, and estimated where two do.

    Args:
        looks: `(num_sets, num_cells)` how many cameras of a set see each cell.
        weights: `(num_cells,)` how likely newcomers appear there; adds up to 1, or is empty.
    """
    return np.asarray(0.5 * ((looks >= 1) @ weights + (looks >= 2) @ weights))


def watches(rig: Rig, subsets: Flags, weights: Floats) -> Floats:
    """Return `watched` for `(num_sets, num_cameras)` sets of cameras."""
    _, seen = seen_floor(rig)
    return watched(subsets.astype(np.float64) @ seen, weights)
