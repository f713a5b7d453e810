"""Where joints were last known, and constant velocity, in plain numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats


def constant_velocity(history_m: Floats, lead_slots: int) -> Floats:
    """See `e3pose.predict.velocities`; returns the joints."""
    newest = history_m[-1]
    before = history_m[-2] if len(history_m) > 1 else np.full_like(newest, np.nan)
    motion = newest - before
    measured = np.isfinite(motion).all(axis=-1)[..., None]
    count = np.maximum(measured.sum(axis=1, keepdims=True), 1)
    mean_motion = np.where(measured, motion, 0.0).sum(axis=1, keepdims=True) / count
    motion = np.where(measured, motion, mean_motion)
    position, age = newest_known(history_m)
    ahead = np.arange(1, lead_slots + 1)[:, None, None, None]
    return np.asarray(position + (ahead + age[..., None]) * motion)


def newest_known(history_m: Floats) -> tuple[Floats, Floats]:
    """See `e3pose.predict.velocities.newest_known`."""
    present = np.asarray(np.isfinite(history_m).all(axis=-1))[::-1]
    age = np.argmax(present, axis=0)
    position = np.take_along_axis(history_m[::-1], age[None, ..., None], axis=0)[0]
    known: NDArray[np.bool_] = np.asarray(present.any(axis=0))
    return np.where(known[..., None], position, np.nan), age.astype(np.float64)
