"""The paper's E3Pose-MV baseline: 3D motion vectors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.predict.base import Prediction
from e3pose.predict.newest import newest_known

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ConstantVelocity:
    """Carry every joint on with its motion between the two newest slots (paper section 4.3).

    A joint that is missing in one of the two moves with the mean motion of the person's other
    joints, from where it was last known.
    """

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        """See `Predictor.predict`."""
        newest = history_m[-1]
        before = history_m[-2] if len(history_m) > 1 else np.full_like(newest, np.nan)
        motion = newest - before
        measured = np.isfinite(motion).all(axis=-1)[..., None]
        count = np.maximum(measured.sum(axis=1, keepdims=True), 1)
        mean_motion = np.where(measured, motion, 0.0).sum(axis=1, keepdims=True) / count
        motion = np.where(measured, motion, mean_motion)
        position, age = newest_known(history_m)
        ahead = np.arange(1, lead_slots + 1)[:, None, None, None]
        return Prediction.of_unknown_error(position + (ahead + age[..., None]) * motion)
