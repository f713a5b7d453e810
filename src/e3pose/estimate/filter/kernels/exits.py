"""Entries and exits (`filter.exits`): the loops."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.filter.exits import FOLLOWED, MOST_S, MOST_UNSEEN_S, PASSED, SETTLED_S
from e3pose.estimate.filter.kernels.blindness import cell
from e3pose.estimate.filter.state import APART_M
from e3pose.estimate.filter.tree import TRUNK
from e3pose.runtime.kernel import kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

TRUNK_LASTS_S = TRUNK.lasts_s


@kernel
def place_back(root: Floats, unseen_s: float, place_m: Floats) -> None:
    """Fill `place_m` `(2,)`: floor position of a person when last published.

    The way on since then, with a velocity that fades, is taken back.

    Args:
        root: `(6,)` state of the root of the body.
        unseen_s: since then.
        place_m: filled.
    """
    way_s = TRUNK_LASTS_S * (math.exp(min(unseen_s, MOST_UNSEEN_S) / TRUNK_LASTS_S) - 1)
    for axis in range(2):
        place_m[axis] = root[axis] - way_s * root[axis + 3]


@kernel
def count_slot(
    dt: float,
    root: int,
    corner_m: Floats,
    old_ids: Integers,
    old_confirmed: Flags,
    old_state: Floats,
    old_seen_s: Floats,
    ids: Integers,
    confirmed: Flags,
    state: Floats,
    seen_s: Floats,
    exits: Floats,
) -> None:
    """Add a slot to `exits`: tracks followed, started and ended.

    Args:
        dt: seconds since the slot before.
        root: joint of the body.
        corner_m: of the cells.
        old_ids: `(num_before,)` of the belief of the slot before, as all up to `old_seen_s`.
        old_confirmed: `(num_before,)`.
        old_state: `(num_before, num_joints, 6)`.
        old_seen_s: `(num_before, num_cameras)`.
        ids: `(num_tracks,)` of the belief now, as all up to `seen_s`.
        confirmed: `(num_tracks,)`.
        state: `(num_tracks, num_joints, 6)`.
        seen_s: `(num_tracks, num_cameras)`.
        exits: as in `Belief`, changed in place.
    """
    places_m = np.empty((2 * len(ids) + len(old_ids), 2))
    followed_s = np.empty(len(places_m))
    count = 0
    for track in range(len(ids)):
        if not confirmed[track]:
            continue
        for axis in range(2):
            places_m[count, axis] = places_m[count + 1, axis] = state[track, root, axis]
        if (seen_s[track] == 0.0).any():
            followed_s[count] = dt
            count += 1
        came = not _has(ids[track], old_ids, old_confirmed)
        if came and exits[:, :, FOLLOWED].sum() > SETTLED_S:
            followed_s[count] = np.nan
            count += 1
    everybody = np.ones(len(ids), np.bool_)
    for track in range(len(old_ids)):
        if old_confirmed[track] and not _has(old_ids[track], ids, everybody):
            place_back(old_state[track, root], old_seen_s[track].min(), places_m[count])
            if _is_alone(places_m[count], state[:, root], confirmed):
                followed_s[count] = np.nan
                count += 1
    count_exits(places_m[:count], followed_s[:count], corner_m, exits)


@kernel
def _has(track_id: int, ids: Integers, counted: Flags) -> bool:
    """Return whether an id is in the list."""
    found = False
    for row in range(len(ids)):
        found = found or (counted[row] and ids[row] == track_id)
    return found


@kernel
def _is_alone(place_m: Floats, roots: Floats, confirmed: Flags) -> bool:
    """Return whether no other track of the same person is at a place."""
    for track in range(len(roots)):
        x, y = roots[track, 0] - place_m[0], roots[track, 1] - place_m[1]
        if confirmed[track] and math.sqrt(x * x + y * y) < APART_M:
            return False
    return True


@kernel
def count_exits(places_m: Floats, followed_s: Floats, corner_m: Floats, exits: Floats) -> None:
    """Add people to the `exits` of `Belief`, and forget what is beyond `MOST_S`.

    Args:
        places_m: `(num_places, 2)` on the floor.
        followed_s: `(num_places,)` seconds that somebody was followed there; NaN for somebody who
            came or left.
        corner_m: of the cells.
        exits: changed in place.
    """
    for adding in (True, False):
        for index in range(len(places_m)):
            column, right = cell(places_m[index, 0] - corner_m[0])
            row, up = cell(places_m[index, 1] - corner_m[1])
            for a in range(2):
                for b in range(2):
                    door = exits[column + a, row + b]
                    weight = (right if a else 1.0 - right) * (up if b else 1.0 - up)
                    if not adding:
                        kept = min(MOST_S / max(door[FOLLOWED], 1e-12), 1.0)
                        door[FOLLOWED] *= kept
                        door[PASSED] *= kept
                    elif math.isnan(followed_s[index]):
                        door[PASSED] += weight
                    else:
                        door[FOLLOWED] += weight * followed_s[index]
