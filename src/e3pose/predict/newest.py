"""Where joints were last known, for predictors that carry them on from there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def newest_known(history_m: Floats) -> tuple[Floats, Floats]:
    """Return the newest known position of every joint, and how old it is.

    Args:
        history_m: `(num_slots, num_tracks, num_joints, 3)` metres, oldest first; NaN where unknown.

    Returns:
        `(num_tracks, num_joints, 3)` metres, NaN where the history never shows the joint, and
        `(num_tracks, num_joints)` slots since, 0 in the newest slot and where never shown.
    """
    present = np.asarray(np.isfinite(history_m).all(axis=-1))[::-1]
    age = np.argmax(present, axis=0)
    position = np.take_along_axis(history_m[::-1], age[None, ..., None], axis=0)[0]
    known: NDArray[np.bool_] = np.asarray(present.any(axis=0))
    return np.where(known[..., None], position, np.nan), age.astype(np.float64)
