"""The paper's policy: least predicted occlusion under long-term energy budgets, eq. (5).

The paper's V weighs IoU, whose size depends on the site, against a queue in slots of activity. Here
it is in camera slots: how many active slots a usual difference of occlusion between two cameras is
worth. At a site this is the paper's eq. (9), with its V = `quality_weight / Situation.spread`. With
`raw`, V is the paper's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.select.policies.base import Selection, Situation, count_at, lowest


@dataclass(frozen=True, slots=True)
class DriftPlusPenalty:
    """Wake the `num_selected` cameras of smallest `V * IoU_n + q_n`, paper eq. (9).

    Attributes:
        num_selected: the paper's C; a mean if it is no whole number.
        quality_weight: V in camera slots; larger prefers clear views to even batteries.
        phase: which camera wins a tie.
        raw: V weighs IoU itself.
    """

    num_selected: float
    quality_weight: float = 1.0
    phase: int = 0
    raw: bool = False

    def select(self, situation: Situation) -> Selection:
        """See `Policy.select`."""
        weight = self.quality_weight / usual_difference(situation, self.raw)
        price = weight * situation.occlusion + situation.price
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
    raw: bool = False

    def select(self, situation: Situation) -> Selection:
        """See `Policy.select`."""
        stride = max(1, int(np.ceil(self.round_trip_s / situation.interval_s - 1e-9)))
        if situation.slot % stride:
            return np.zeros(len(situation.online), dtype=bool)
        foreseen = np.nan_to_num(situation.own_occlusion, nan=0.0)
        weight = self.quality_weight / usual_difference(situation, self.raw)
        price = weight * foreseen + situation.price
        count = count_at(situation.slot // stride, self.num_selected)
        return lowest(price, situation.online, count, self.phase)


def usual_difference(situation: Situation, raw: bool) -> float:
    """Return the difference of occlusion, eq. (4), that V camera slots are paid for; 1 if `raw`."""
    # Before anybody has hidden anybody there is nothing to weigh.
    return 1.0 if raw else situation.spread or 1.0
