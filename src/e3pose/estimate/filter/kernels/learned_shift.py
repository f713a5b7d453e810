"""Learned shifts of cameras: the loops of `filter.learned_shift`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.filter.kernels.scratch import Detectors
from e3pose.estimate.filter.learned_noise import MEMORY
from e3pose.estimate.filter.learned_shift import (
    COUNT,
    LEAST,
    MOST,
    PRIOR,
)
from e3pose.estimate.filter.outliers import OUTLIER_SIGMAS
from e3pose.runtime.kernel import kernel

Floats = NDArray[np.float64]


@kernel
def recall_shifts(shifts: Floats, sizes: Floats, detectors: Detectors) -> None:
    """Start a slot: compute the shift subtracted from all keypoints."""
    find_shifts(shifts, sizes, 0.0, detectors.shifts_px)
    for camera in range(len(shifts)):
        for column in range(3):
            detectors.residuals[camera, column] = 0.0


@kernel
def find_shifts(shifts: Floats, sizes: Floats, least_known: float, shifts_px: Floats) -> None:
    """Fill `shifts_px` `(num_cameras, 2)`: what is taken off (`learned_shift.shifts_px`).

    Args:
        shifts: `Belief.shifts`.
        sizes: `(num_cameras, 2)` of the images.
        least_known: keypoints, of cameras taught by fewer it is NaN.
        shifts_px: filled.
    """
    for camera in range(len(shifts)):
        count = shifts[camera, COUNT]
        trust = count / (count + PRIOR)
        squares = trust**2 * (shifts[camera, 0] ** 2 + shifts[camera, 1] ** 2)
        least = (LEAST * max(sizes[camera, 0], sizes[camera, 1])) ** 2
        kept = 1.0 - least / squares if squares > least else 0.0
        for axis in range(2):
            taken = kept * trust * shifts[camera, axis]
            shifts_px[camera, axis] = taken if count >= least_known else np.nan


@kernel
def compare_shift(
    camera: int, share: float, right: float, down: float, variance: float, detectors: Detectors
) -> None:
    """Add the residual of one keypoint, in pixels; the bias of its joint is not taken off."""
    off = math.sqrt((right * right + down * down) / variance) / OUTLIER_SIGMAS
    weight = share * share / (off if off > 1.0 else 1.0)
    detectors.residuals[camera, 0] += weight * right
    detectors.residuals[camera, 1] += weight * down
    detectors.residuals[camera, COUNT] += weight


@kernel
def learn_shifts(shifts: Floats, sizes: Floats, detectors: Detectors) -> None:
    """Add the evidence of a slot to `shifts`, which is `Belief.shifts`."""
    for camera in range(len(shifts)):
        fresh, count = detectors.residuals[camera, COUNT], shifts[camera, COUNT]
        if not fresh > 0.0:
            continue
        squares = 0.0
        for axis in range(2):
            found = detectors.residuals[camera, axis] + fresh * detectors.shifts_px[camera, axis]
            shifts[camera, axis] = (count * shifts[camera, axis] + found) / (count + fresh)
            squares += shifts[camera, axis] ** 2
        most = MOST * max(sizes[camera, 0], sizes[camera, 1])
        if squares > most * most:
            for axis in range(2):
                shifts[camera, axis] *= most / math.sqrt(squares)
        shifts[camera, COUNT] = count + fresh if count + fresh < MEMORY else MEMORY
