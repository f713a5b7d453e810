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

from typing import TYPE_CHECKING

import numpy as np

from e3pose.estimate.filter.learned_noise import LEAST_KNOWN
from e3pose.estimate.filter.state import Floats, Model
from e3pose.runtime.deferred import Deferred

if TYPE_CHECKING:
    from e3pose.estimate.filter.kernels import learned_shift as kernels
else:
    kernels = Deferred("e3pose.estimate.filter.kernels.learned_shift")

COUNT = 2  # layout: of the last axis of `Belief.shifts`; before it right and down
# Keypoints that no shift at all counts for. Keypoints of one body are off together: on real
# detections they count as 2.5 to 5 times fewer than independent ones, for which 300 would do
# (`lab/benchmarks/body_shifts.py`). A body that is off in one view for seconds is no shift of the
# camera.
PRIOR = 900.0
MOST = 30 / 1032  # of the image: farther off a camera's detections fit nobody
# What simulated cameras that are not shifted at all are found to be off after minutes: people's
# bones and the motion model pull all cameras a little the same way.
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
    kernels.find_shifts(shifts, model.rig.image_sizes, least_known, taken_px)
    return taken_px
