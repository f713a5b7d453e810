"""The simplest baseline: all joints stay in place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.predict.base import Prediction
from e3pose.predict.newest import newest_known


@dataclass(frozen=True, slots=True)
class ZeroVelocity:
    """Leave every joint where it was last known."""

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        """See `Predictor.predict`."""
        position, _ = newest_known(history_m)
        return Prediction.of_unknown_error(np.repeat(position[None], lead_slots, axis=0))
