"""Dynamics of joints: how fast they moved, and how sure that was, as a filter knew it.

Six numbers a joint, the last axis of every array called `dynamics`: velocity along x, y and z in
m/s; the standard deviations of position (m) and velocity (m/s) along an axis, and the correlation
of the two. NaN where a joint is missing or nothing is known. A smoother needs them and no more of a
slot, besides the position: `estimate.smooth`.

Packed, a joint is nine bytes: the velocity as half floats, then a byte each. Of a standard
deviation it is a logarithm in steps of 4 %, of a correlation a step of 1/127; 0 is unknown.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel

Bytes = NDArray[np.uint8]

SIZE, PACKED_SIZE = 6, 9
SMALLEST = 1e-4  # of a standard deviation: code 1
STEPS_PER_OCTAVE = 16.0
MOST_CORRELATED = 0.99


@kernel
def find_dynamics(state: Floats, covariance: Floats, dynamics: Floats) -> None:
    """Fill the dynamics of a joint.

    Args:
        state: `(6,)` position and velocity.
        covariance: `(6, 6)` of them.
        dynamics: `(6,)`, filled.
    """
    position = both = velocity = 0.0
    for axis in range(3):
        dynamics[axis] = state[3 + axis]
        position += covariance[axis, axis]
        both += covariance[axis, 3 + axis]
        velocity += covariance[3 + axis, 3 + axis]
    sigma_m, sigma_mps = math.sqrt(position / 3), math.sqrt(velocity / 3)
    dynamics[3], dynamics[4] = sigma_m, sigma_mps
    dynamics[5] = both / 3 / (sigma_m * sigma_mps)


def covariance_of(dynamics: Floats) -> Floats:
    """Return `(*batch, 2, 2)`: covariance of position and velocity along an axis."""
    sigma_m, sigma_mps, correlation = np.moveaxis(dynamics[..., 3:], -1, 0)
    both = correlation * sigma_m * sigma_mps
    rows = np.array([[sigma_m**2, both], [both, sigma_mps**2]])
    return np.asarray(np.moveaxis(rows, (0, 1), (-2, -1)))


def packed(dynamics: Floats) -> Bytes:
    """Return dynamics `(*batch, 6)` as `(*batch, 9)` bytes."""
    known = np.isfinite(dynamics).all(axis=-1, keepdims=True)
    safe = np.where(known, dynamics, 1.0)
    velocity = np.ascontiguousarray(np.where(known, safe[..., :3], 0.0), dtype="<f2").view(np.uint8)
    steps = 1 + STEPS_PER_OCTAVE * np.log2(np.maximum(safe[..., 3:5], SMALLEST) / SMALLEST)
    correlation = 128 + 127 * np.clip(safe[..., 5:], -1.0, 1.0)
    codes = np.rint(np.clip(np.concatenate([steps, correlation], axis=-1), 1, 255))
    return np.concatenate([velocity, np.where(known, codes, 0).astype(np.uint8)], axis=-1)


def unpacked(codes: Bytes) -> Floats:
    """Return the dynamics `(*batch, 6)` of `(*batch, 9)` bytes."""
    velocity = np.ascontiguousarray(codes[..., :6]).view("<f2").astype(np.float64)
    steps = codes[..., 6:].astype(np.float64)
    sigma = SMALLEST * 2.0 ** ((steps[..., :2] - 1) / STEPS_PER_OCTAVE)
    correlation = np.clip((steps[..., 2:] - 128) / 127, -MOST_CORRELATED, MOST_CORRELATED)
    known = (codes[..., 6:] > 0).all(axis=-1, keepdims=True)
    return np.where(known, np.concatenate([velocity, sigma, correlation], axis=-1), np.nan)
