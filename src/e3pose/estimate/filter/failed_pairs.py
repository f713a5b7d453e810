"""Failed pairs: detections that never become a person, by their place in the image.

A poster, a mirror image, or a person whom one camera alone can see waits for a second camera in
every slot. So it is counted per camera and cell of its image how often another camera looked while
a detection waited there and no track came of it. Each look counts as the share of the first
camera's view that it overlaps, the probability with which policies expect it to start somebody.
After `SEVERAL` such looks the cell's detections no longer count as people to be met. They still
start a track as soon as two agree, which empties the cells of both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.geometry.camera import Rig

Floats = NDArray[np.float64]

ROWS, COLUMNS = 8, 10  # layout: cells of an image
SEVERAL = 3.0  # looks that must have failed
MOST = 9.0  # looks that are kept
FADES_S = 30.0  # until their number is down to 1/e


def nothing_known(rig: Rig) -> Floats:
    """Return `(num_cameras, ROWS, COLUMNS)` counts before the first slot."""
    return np.zeros((len(rig), ROWS, COLUMNS))
