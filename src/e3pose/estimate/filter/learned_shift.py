"""Learned shift: a constant keypoint offset of each camera, subtracted.

A camera that was bumped, or a calibration that is off by a fraction of a degree, moves all of its
keypoints by about as many pixels. After the update of a slot each keypoint is compared with where
all other evidence puts its joint, as `learned_noise` does; the mean over minutes is the shift.
What lasts for a few seconds of one joint of one person (`bias`) is part of that mean, so that a
shift is not taken for as many biases, which every new person would have to teach again.

Shifts that move all cameras' people alike in the world cannot be seen, and are not learned: what
all cameras agree about leaves no residual.
"""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.outliers import LEAST_KNOWN, MEMORY, OUTLIER_SIGMAS
from e3pose.estimate.filter.scratch import Detectors
from e3pose.estimate.filter.state import Model

COUNT = 2  # layout: of the last axis of `Belief.shifts`; before it right and down
# Keypoints that no shift at all counts for. Keypoints of one body are off together: on real
# detections they count as 2.5 to 5 times fewer than independent ones, for which 300 would do.
# A body that is off in one view for seconds is no shift of the camera.
# tuned: keypoints | 300 for a prior of 1 px, simulated, seeds 701 to 704; three times that as
#   keypoints of one body err together, lab/experiments/2026-11-22-shifts-learned-live.md | shift
PRIOR = 900.0
# tuned: share of the image | beyond that detections fit nobody | shift
MOST = 30 / 1032  # of the image: farther off a camera's detections fit nobody
# What simulated cameras that are not shifted at all are found to be off after minutes: people's
# bones and the motion model pull all cameras a little the same way.
# tuned: share of the image | simulated: unshifted cameras are found up to 0.9 px off after a minute
#   | least shift
LEAST = 1 / 1032  # of the image: what is not more than this is none


def shifts_px(shifts: Floats, model: Model) -> Floats:
    """Return `(num_cameras, 2)` pixels right and down subtracted from each camera's keypoints.

    Small ones are left alone and large ones hardly reduced: the non-negative garrote (Breiman,
    Technometrics 37, 1995).

    Args:
        shifts: `Belief.shifts`.
        model: the rig.
    """
    return _found(shifts, model, 0.0)


def found_px(shifts: Floats, model: Model) -> Floats:
    """Return `(num_cameras, 2)` pixels subtracted; NaN where too little is seen."""
    return _found(shifts, model, LEAST_KNOWN)


def _found(shifts: Floats, model: Model, least_known: float) -> Floats:
    taken_px = np.empty((len(shifts), 2))
    find_shifts(shifts, model.rig.image_sizes, least_known, taken_px)
    return taken_px


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
