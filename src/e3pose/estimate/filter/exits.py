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

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.filter.state import APART_M, Belief, Model
from e3pose.estimate.filter.tree import TRUNK

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

FOLLOWED, PASSED = 0, 1  # of the last axis: seconds, and people who came or left
PRIOR_S, PRIOR_HZ = 1.0, 0.03  # what is thought of a place, and the seconds that this counts for
MOST_UNSEEN_S = 1.0  # how far back the way of somebody unseen is taken
MOST_S = 30.0  # per place that are remembered: doors get locked
MOST_LEFT_ODDS = 1.0  # who has more likely left than not is followed, but not shown
SETTLED_S = 4.0  # of people followed before who appears has come: at first everybody appears


def measured_m(belief: Belief, rows: Ints | Flags, model: Model) -> Floats:
    """Return `(num_rows, 2)`: where on the floor the people at `rows` were when last shown.

    The way on since then, with a velocity that fades, is taken back.
    """
    root = belief.state[rows, model.tree.levels[0][0]]
    unseen_s = np.minimum(belief.last_seen_s[rows].min(axis=1, initial=np.inf), MOST_UNSEEN_S)
    way_s = TRUNK.lasts_s * (np.exp(unseen_s / TRUNK.lasts_s) - 1)
    return np.asarray(root[:, :2] - way_s[:, None] * root[:, 3:5])


def learn(before: Belief, belief: Belief, model: Model) -> Floats:
    """Return the counts after a slot.

    Args:
        before: the belief of the slot before.
        belief: of this slot, with the counts of the slot before.
        model: the rig.
    """
    from e3pose.estimate.filter.kernels.shown import count_exits

    exits: Floats = belief.exits
    root = model.tree.levels[0][0]
    places_m = belief.state[(belief.last_seen_s == 0).any(axis=1) & belief.confirmed, root, :2]
    first = math.isnan(before.time_s)
    followed_s = np.full(len(places_m), 0.0 if first else belief.time_s - before.time_s)
    known, shown = before.track_ids[before.confirmed], belief.track_ids[belief.confirmed]
    if not np.array_equal(known, shown):
        passed_m = _passed_m(before, belief, model)
        places_m = np.concatenate([places_m, passed_m])
        followed_s = np.concatenate([followed_s, np.full(len(passed_m), np.nan)])
    if len(places_m) == 0:
        return exits
    exits = exits.copy()
    count_exits(np.ascontiguousarray(places_m), followed_s, model.corner_m, exits)
    return exits


def _passed_m(before: Belief, belief: Belief, model: Model) -> Floats:
    """Return `(num_people, 2)`: where people came and left in a slot."""
    root = model.tree.levels[0][0]
    came = belief.confirmed & ~np.isin(belief.track_ids, before.track_ids[before.confirmed])
    came &= belief.exits[..., FOLLOWED].sum() > SETTLED_S
    left = before.confirmed & ~np.isin(before.track_ids, belief.track_ids)
    ends_m = measured_m(before, left, model)
    others_m = belief.state[belief.confirmed, root, :2]
    apart_m = np.linalg.norm(ends_m[:, None] - others_m, axis=-1)
    alone = apart_m.min(axis=1, initial=np.inf) >= APART_M  # others were second tracks
    return np.concatenate([belief.state[came, root, :2], ends_m[alone]])
