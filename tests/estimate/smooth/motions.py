"""Motions whose every number is known."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.take import MEASURED, MISSING, Motion


def motion(joints_m: Floats, sigma_m: float | Floats = 0.02, first: int = 0) -> Motion:
    """Return a motion of measured joints; those that are NaN are missing."""
    known = np.isfinite(joints_m).all(axis=-1)
    return Motion(
        7,
        first,
        joints_m,
        np.where(known, sigma_m, np.nan),
        np.where(known, 0.9, 0.0),
        np.where(known, MEASURED, MISSING).astype(np.uint8),
    )


def waving(num_slots: int, hz: float, fps: float, num_joints: int = 17) -> Floats:
    """Return joints that swing along x, 10 cm either way."""
    joints = np.zeros((num_slots, num_joints, 3))
    joints[..., 0] = 0.1 * np.sin(2 * np.pi * hz * np.arange(num_slots) / fps)[:, None]
    return joints
