"""Where joints were last known, for predictors that carry them on from there."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.predict.kernels import velocity as kernels


def newest_known(history_m: Floats) -> tuple[Floats, Floats]:
    """Return the newest known position of every joint, and how old it is.

    Args:
        history_m: `(num_slots, num_tracks, num_joints, 3)` metres, oldest first; NaN where unknown.

    Returns:
        `(num_tracks, num_joints, 3)` metres, NaN where the history never shows the joint, and
        `(num_tracks, num_joints)` slots since, 0 in the newest slot and where never shown.
    """
    position, age = np.empty(history_m.shape[1:]), np.empty(history_m.shape[1:3])
    kernels.find_newest(np.ascontiguousarray(history_m, dtype=np.float64), position, age)
    return position, age
