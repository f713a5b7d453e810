"""The paper's E3Pose-MV baseline: 3D motion vectors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.predict.base import Prediction
from e3pose.predict.kernels import velocity as kernels


@dataclass(frozen=True, slots=True)
class ConstantVelocity:
    """Carry every joint on with its motion between the two newest slots (paper section 4.3).

    A joint that is missing in one of the two moves with the mean motion of the person's other
    joints, from where it was last known.
    """

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        """See `Predictor.predict`."""
        joints_m = np.empty((lead_slots, *history_m.shape[1:]))
        kernels.go_on(np.ascontiguousarray(history_m, dtype=np.float64), joints_m)
        return Prediction.of_unknown_error(joints_m)
