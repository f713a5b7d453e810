"""Where people come and go, in plain numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from tests.reference.filter_blindness import around

from e3pose.estimate.filter.exits import FOLLOWED, MOST_S, MOST_UNSEEN_S, SETTLED_S
from e3pose.estimate.filter.state import APART_M, Belief, Model
from e3pose.estimate.filter.tree import TRUNK

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


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
    root = model.tree.levels[0][0]
    places_m = belief.state[(belief.last_seen_s == 0).any(axis=1) & belief.confirmed, root, :2]
    followed_s = np.full(len(places_m), np.nan_to_num(belief.time_s - before.time_s))
    passed_m = _passed_m(before, belief, model)
    added = np.concatenate(
        [
            np.stack([followed_s, np.zeros(len(places_m))], axis=-1),
            np.tile([0.0, 1.0], (len(passed_m), 1)),
        ]
    )
    return count_exits(belief.exits, np.concatenate([places_m, passed_m]), added, model.corner_m)


def count_exits(exits: Floats, places_m: Floats, added: Floats, corner: Floats) -> Floats:
    """See `kernels.exits.count_exits`; `added` `(num_places, 2)` is what each place adds."""
    cells, weights = around(places_m - corner)
    where = (cells[..., 0], cells[..., 1])
    exits = exits.copy()
    np.add.at(exits, where, weights[..., None] * added[:, None])
    kept = np.minimum(MOST_S / np.maximum(exits[where][..., FOLLOWED], 1e-12), 1.0)
    exits[where] = exits[where] * kept[..., None]
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
