"""The seam of predictors: a function from the recent past of all people to their near future."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from e3pose.base.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Future joints, with their expected errors.

    Attributes:
        joints_m: `(lead_slots, num_tracks, num_joints, 3)` metres: entry i is i + 1 slots ahead;
            NaN only for joints that the history never shows.
        error_m: `(lead_slots, num_tracks, num_joints)` expected distance from the truth in metres;
            NaN where it is unknown, which is everywhere for a predictor that does not estimate it.
    """

    joints_m: Floats
    error_m: Floats

    @classmethod
    def of_unknown_error(cls, joints_m: Floats) -> Prediction:
        """Return the prediction `joints_m` without a claim about its error."""
        return cls(joints_m, np.full(joints_m.shape[:-1], np.nan))


class Predictor(Protocol):
    """Predicts joints a few slots ahead."""

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        """Predict all joints.

        Args:
            history_m: `(num_slots, num_tracks, num_joints, 3)` metres, oldest first; NaN where a
                joint was not estimated or the person was absent.
            interval_s: seconds per slot.
            lead_slots: number of slots to predict, the paper's tau, at least 1.

        Returns:
            The joints of every track in each of the next `lead_slots` slots.
        """
        ...
