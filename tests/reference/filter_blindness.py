"""Where cameras show nobody although somebody is there: what a miss proves at a place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.filter.blindness import (
    LOOKS,
    MOST_LOOKS,
    around,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def learn(sights: Floats, places_m: Floats, looks: Floats, shown: Floats, corner: Floats) -> Floats:
    """Return the counts after people were proved to be at places.

    Args:
        sights: as for `chance`; not changed.
        places_m: `(num_people, 2)` on the floor.
        looks: `(num_people, num_cameras)` to add.
        shown: `(num_people, num_cameras)` likewise.
        corner: `corner_m` of the rig.
    """
    people, cameras = np.nonzero(looks)
    if len(people) == 0:
        return sights
    cells, weights = around(places_m - corner)
    where = (cameras[:, None], cells[people, :, 0], cells[people, :, 1])
    told = np.stack([looks[people, cameras], shown[people, cameras]], axis=-1)
    sights = sights.copy()
    np.add.at(sights, where, weights[people][..., None] * told[:, None])
    kept = np.minimum(MOST_LOOKS / np.maximum(sights[where][..., LOOKS], 1e-12), 1.0)
    sights[where] = sights[where] * kept[..., None]
    return sights
