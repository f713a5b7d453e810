"""Motion freed of noise with the slots before and after: what only somebody later can know."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats

# Half the window. With a parabola and these weights it passes motion of up to 4 or 5 Hz, in which
# nearly all power of human movement lies (Winter, Biomechanics and Motor Control, chapter 3).
HALF_S = 0.12
LEAST_SAMPLES = 4  # one more than a parabola needs
OUTLIER_M = 0.1  # from the first fit, beyond which a sample counts less: thrice the usual noise


def smooth(joints_m: Floats, interval_s: float) -> Floats:
    """Fit a parabola to the neighbourhood of every slot, joint by joint; outliers count less.

    Args:
        joints_m: `(num_slots, *batch, 3)` metres of one person, NaN where missing.
        interval_s: seconds per slot.

    Returns:
        The same shape. A gap is closed if there are samples on both sides of it within 0.12 s; NaN
        elsewhere. At less than 17 slots per second there is nothing to average: joints stay as they
        are, and a single missing one is put between its neighbours.
    """
    reach = int(HALF_S / interval_s + 1e-6)
    if reach < 2:
        between = joints_m.copy()
        between[1:-1] = (joints_m[2:] + joints_m[:-2]) / 2
        return np.where(np.isfinite(joints_m), joints_m, between)
    known: NDArray[np.bool_] = np.asarray(np.isfinite(joints_m).all(axis=-1))
    first = _fit(joints_m, known.astype(np.float64), reach)
    with np.errstate(invalid="ignore"):
        apart: Floats = np.asarray(np.linalg.norm(joints_m - first, axis=-1))
    weight: Floats = np.where(known, np.minimum(1.0, OUTLIER_M / np.maximum(apart, 1e-9)), 0.0)
    return _fit(joints_m, np.where(known & ~np.isfinite(apart), 1.0, weight), reach)


def _fit(joints_m: Floats, weight: Floats, reach: int) -> Floats:
    """Return the value in the middle of the weighted parabola around every slot."""
    num_slots = len(joints_m)
    pad = [(reach, reach)] + [(0, 0)] * (weight.ndim - 1)
    weights = np.pad(weight, pad)
    values = np.pad(np.where(weight[..., None] > 0, joints_m, 0.0), [*pad, (0, 0)])
    moments = np.zeros((5, *weight.shape))
    sums = np.zeros((3, *joints_m.shape))
    before, after, count = (np.zeros(weight.shape) for _ in range(3))
    for offset in range(-reach, reach + 1):
        t = offset / reach
        there = weights[reach + offset : reach + offset + num_slots]
        value = values[reach + offset : reach + offset + num_slots]
        kernel = there * (1 - abs(offset / (reach + 1)) ** 3) ** 3
        count += there > 0
        before += (there > 0) & (offset <= 0)
        after += (there > 0) & (offset >= 0)
        for power in range(5):
            moments[power] += kernel * t**power
        for power in range(3):
            sums[power] += (kernel * t**power)[..., None] * value
    usable = (count >= LEAST_SAMPLES) & (before > 0) & (after > 0)
    matrix = np.stack([moments[0:3], moments[1:4], moments[2:5]])  # (3, 3, num_slots, *batch)
    matrix = np.moveaxis(matrix, (0, 1), (-2, -1))
    matrix = np.where(usable[..., None, None], matrix, np.eye(3))
    solved = np.linalg.solve(matrix, np.moveaxis(sums, 0, -2))[..., 0, :]
    return np.asarray(np.where(usable[..., None], solved, np.nan))
