"""Detection maps of cameras: the evidence of a missed detection by place.

A rig's geometry says which places lie inside an image, but not what stands between: a wall, a
shelf, people who always stand there, dirt on a lens. So the looks at people who were there are
counted per camera and place of the floor, and how many of them showed the person. Whether somebody
was there at a miss turns out later, when a camera shows the person again whom another one showed of
late: misses wait until then, and those of a track that ends say nothing about cameras.

A camera that shows people at a place with probability p leaves, by a miss, 1 - p of the odds that
somebody is there. Existence counts it as that share of a miss in plain sight which the logarithms
have: log(1 - p) / log(1 - PLAIN).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.geometry.camera import Rig

Floats = NDArray[np.float64]

FASTEST_S = 1 / 25  # above this rate a view says less, since successive ones say the same
CELL_M = 0.75  # people's own size, and the reach of a door
NUM_CELLS = 40  # capacity: along each side of the square around the cameras
PLAIN = 0.9  # detections of a look in plain sight: what is thought of places nobody was seen at
PRIOR_VIEWS = 2.0  # that this counts for
MOST_VIEWS = 60.0  # kept per place, a few seconds of one person: things get moved
VIEWS, SHOWN = 0, 1  # layout: of the last axis
# So many cameras must have shown a person of late to prove that one is there: what lives on the
# detections of one camera alone may be a ghost, whose misses would say that all others are blind.
# A track that no camera has shown for as long ends.
PROOF_CAMERAS, PROOF_S = 2, 1.0


def corner_m(rig: Rig) -> Floats:
    """Return `(2,)`: where on the floor the first cell begins."""
    return np.asarray(rig.centers_m[:, :2].mean(axis=0) - NUM_CELLS * CELL_M / 2)


def nothing_known(rig: Rig) -> Floats:
    """Return `(num_cameras, NUM_CELLS, NUM_CELLS, 2)` counts before the first slot."""
    return np.zeros((len(rig), NUM_CELLS, NUM_CELLS, 2))
