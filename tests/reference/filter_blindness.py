"""Where cameras show nobody although somebody is there: what a miss proves at a place."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.estimate.filter.blindness import (
    CELL_M,
    MOST_VIEWS,
    NUM_CELLS,
    PLAIN,
    PRIOR_VIEWS,
    VIEWS,
)


def learn(
    detection_map: Floats, places_m: Floats, views: Floats, shown: Floats, corner: Floats
) -> Floats:
    """Return the counts after people were proved to be at places."""
    people, cameras = np.nonzero(views)
    if len(people) == 0:
        return detection_map
    cells, weights = around(places_m - corner)
    where = (cameras[:, None], cells[people, :, 0], cells[people, :, 1])
    added = np.stack([views[people, cameras], shown[people, cameras]], axis=-1)
    detection_map = detection_map.copy()
    np.add.at(detection_map, where, weights[people][..., None] * added[:, None])
    kept = np.minimum(MOST_VIEWS / np.maximum(detection_map[where][..., VIEWS], 1e-12), 1.0)
    detection_map[where] = detection_map[where] * kept[..., None]
    return detection_map


def chance(detection_map: Floats, cameras: Integers, places_m: Floats, corner: Floats) -> Floats:
    """Return `(num_views, num_places)` in (0, 1): how likely a view shows who is there."""
    cells, weights = around(places_m - corner)
    near = detection_map[cameras[:, None, None], cells[..., 0], cells[..., 1]]
    views, shown = np.moveaxis((near * weights[..., None]).sum(axis=-2), -1, 0)
    return np.asarray((shown + PRIOR_VIEWS * PLAIN) / (views + PRIOR_VIEWS))


def proof(detection_map: Floats, cameras: Integers, places_m: Floats, corner: Floats) -> Floats:
    """Return `(num_views, num_places)` in [0, 1]: the share of a miss in plain sight.

    Arguments are those of `chance`.
    """
    missing = 1 - chance(detection_map, cameras, places_m, corner)
    blind = np.log(np.maximum(missing, 1 - PLAIN)) / np.log(1 - PLAIN)
    return np.asarray(np.minimum(blind, 1.0))


def around(offset_m: Floats) -> tuple[Integers, Floats]:
    """Return the four cells `(num_places, 4, 2)` nearest to each place, and their weights."""
    position = np.clip(offset_m / CELL_M - 0.5, 0.0, NUM_CELLS - 1.001)
    low = np.floor(position).astype(np.int64)
    part = position - low
    corners = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    weights = np.where(corners, part[:, None], 1 - part[:, None]).prod(axis=-1)
    return low[:, None] + corners, weights
