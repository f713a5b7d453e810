"""The paper's policy: least predicted occlusion under long-term energy budgets.

The paper's V weighs IoU, whose size depends on the site, against a queue in slots of activity. Here
it is in camera slots: how many active slots a usual difference of occlusion between two cameras is
worth. At a site this is the paper's eq. (9), with its V = `quality_weight / Situation.spread`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.select.policies.base import Floats, Selection, Situation, count_at, lowest


@dataclass(frozen=True, slots=True)
class DriftPlusPenalty:
    """Wake the `num_selected` cameras of smallest `V * IoU_n + q_n`, paper eq. (9).

    Attributes:
        num_selected: the paper's C; a mean if it is no whole number.
        quality_weight: V in camera slots; larger prefers clear views to even batteries.
        phase: which camera wins a tie.
    """

    num_selected: float
    quality_weight: float = 1.0
    phase: int = 0

    def select(self, situation: Situation) -> Selection:
        """See `Policy.select`."""
        price = penalty(self.quality_weight, situation.occlusion, situation) + situation.price
        count = count_at(situation.slot, self.num_selected)
        return lowest(price, situation.online, count, self.phase)


@dataclass(frozen=True, slots=True)
class Central2D:
    """The same decision from boxes that the cameras predict themselves: framework (b) of the paper.

    The cameras send what they foresee and wait for the answer before they detect, so that one
    decision takes a round trip; the frames captured meanwhile are dropped, and only every
    `ceil(round_trip_s / interval_s)`-th slot is estimated at all.
    """

    num_selected: float
    quality_weight: float = 1.0
    round_trip_s: float = 0.05
    phase: int = 0

    def select(self, situation: Situation) -> Selection:
        """See `Policy.select`."""
        stride = max(1, int(np.ceil(self.round_trip_s / situation.interval_s - 1e-9)))
        if situation.slot % stride:
            return np.zeros(len(situation.online), dtype=bool)
        foreseen = np.nan_to_num(situation.own_occlusion, nan=0.0)
        price = penalty(self.quality_weight, foreseen, situation) + situation.price
        count = count_at(situation.slot // stride, self.num_selected)
        return lowest(price, situation.online, count, self.phase)


def penalty(quality_weight: float, occlusion: Floats, situation: Situation) -> Floats:
    """Return `(num_cameras,)` what occlusion of eq. (4) costs, in slots of activity."""
    scale = situation.spread or 1.0  # before anybody has hidden anybody there is nothing to weigh
    return np.asarray(quality_weight / scale * occlusion)
