"""The One-Euro filter (Casiez, Roussel, Vogel, CHI 2012): a low-pass that speeds up with motion.

    cut-off = least + beta |speed|,    x <- x + a (new - x),    a = 1 / (1 + rate / (2 pi cut-off))

It looks at no later slot, so it lags; what runs live can be had here, too.
"""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.take import Motion

# tuned: Hz per m/s | by reasoning: a first guess | not measured
BETA_PER_M = 10.0  # Hz by which each metre per second raises the cut-off
SPEED_CUTOFF_HZ = 1.0  # definition: of the speed itself, as published


def one_euro(motion: Motion, interval_s: float, cutoff_hz: float) -> Motion:
    """Return the motion filtered; a joint that was missing starts again.

    Args:
        motion: of one person.
        interval_s: seconds per slot.
        cutoff_hz: the least cut-off, of a joint at rest, Hz.
    """
    joints_m = motion.joints_m.copy()
    place: Floats = np.full(joints_m.shape[1:], np.nan)
    velocity: Floats = np.zeros_like(place)
    slow = _share(np.float64(SPEED_CUTOFF_HZ), interval_s)
    for row, new in enumerate(motion.joints_m):
        goes_on = np.isfinite(place) & np.isfinite(new)
        speed = np.where(goes_on, (new - place) / interval_s, 0.0)
        velocity = np.where(goes_on, velocity + slow * (speed - velocity), 0.0)
        cutoff = cutoff_hz + BETA_PER_M * np.linalg.norm(velocity, axis=-1, keepdims=True)
        place = np.where(goes_on, place + _share(cutoff, interval_s) * (new - place), new)
        joints_m[row] = place
    return Motion(
        motion.track_id, motion.first, joints_m, motion.sigma_m, motion.scores, motion.origin
    )


def _share(cutoff_hz: Floats | np.float64, interval_s: float) -> Floats:
    return np.asarray(1 / (1 + 1 / (2 * np.pi * cutoff_hz * interval_s)))
