"""Exits: the probability that an unseen person has left, by place.

People leave through doors and over the borders of what the cameras see, seldom from the middle of
a room. So it is counted, per place of the floor, for how long people were followed there and how
many were first seen or lost for good there. Together they are a hazard: how many of those who are
there leave in a second. Somebody who is found again after a loss was counted as one who left and
one who came, but at a place where people are followed for minutes that hardly counts.

With the hazard h of the place where somebody was last measured, t seconds ago, and looks since
then that show people there with probabilities p, the odds that this person has left are

    h t / prod (1 - p).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from e3pose.estimate.filter.state import Belief, Model
from e3pose.runtime.deferred import Deferred

if TYPE_CHECKING:
    from e3pose.estimate.filter.kernels import exits as kernels
else:
    kernels = Deferred("e3pose.estimate.filter.kernels.exits")

FOLLOWED, PASSED = 0, 1  # of the last axis: seconds, and people who came or left
PRIOR_S, PRIOR_HZ = 1.0, 0.03  # what is thought of a place, and the seconds that this counts for
MOST_UNSEEN_S = 1.0  # how far back the way of somebody unseen is taken
MOST_S = 30.0  # kept per place: doors get locked
MOST_LEFT_ODDS = 1.0  # who has more likely left than not is followed, but not shown
SETTLED_S = 4.0  # of people followed before who appears has come: at first everybody appears


def count_slot(before: Belief, belief: Belief, model: Model) -> None:
    """Add a slot to the counts `belief.exits`, in place.

    Args:
        before: the belief of the slot before.
        belief: of this slot, with a copy of the counts of the slot before.
        model: the rig.
    """
    first = math.isnan(before.time_s)
    kernels.count_slot(
        0.0 if first else belief.time_s - before.time_s,
        int(model.tree.order[0]),
        model.corner_m,
        before.track_ids,
        before.confirmed,
        before.state,
        before.last_seen_s,
        belief.track_ids,
        belief.confirmed,
        belief.state,
        belief.last_seen_s,
        belief.exits,
    )
