"""What every predictor is: a function from the recent past of all people to their near future."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Predictor(Protocol):
    """Look a few slots ahead."""

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Floats:
        """Predict where all joints will be.

        Args:
            history_m: `(num_slots, num_tracks, num_joints, 3)` metres, oldest first; NaN where a
                joint was not estimated or the person was not there yet.
            interval_s: seconds a slot.
            lead_slots: how many slots to look ahead, the paper's tau, at least 1.

        Returns:
            `(lead_slots, num_tracks, num_joints, 3)` metres: entry i is i + 1 slots ahead; NaN only
            for joints that the history never shows.
        """
        ...
