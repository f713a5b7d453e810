"""A take: the motion of all people over a range of slots.

What smoothing and exports work on. A take is read from a store or from a table of poses, or made of
the records of a replay. Missing is NaN, never a number.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.base.errors import InputError
from e3pose.model.people import People
from e3pose.model.skeleton import Skeleton

Origins = NDArray[np.uint8]

# Where a joint's place comes from.
MISSING, MEASURED, PREDICTED, FILLED = range(4)
ORIGINS = ("missing", "measured", "predicted", "filled")
MAX_JOINTS_HELD = 2**26  # in all slots: some gigabytes


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """One person from the first to the last slot in which they were shown.

    Attributes:
        track_id: the identity.
        first: the slot of the first row.
        joints_m: `(num_slots, num_joints, 3)` world metres, z up; NaN where missing.
        sigma_m: `(num_slots, num_joints)` standard deviation along an axis; NaN where unknown.
        scores: `(num_slots, num_joints)` in [0, 1], 0 where missing.
        origin: `(num_slots, num_joints)` an index of `ORIGINS`: measured in the slot, predicted
            from others by the estimator, filled in afterwards, or missing.
        dynamics: `(num_slots, num_joints, 6)` of the joints as they were estimated, which smoothing
            reads, see `model.dynamics`; None where nothing is known of them.
    """

    track_id: int
    first: int
    joints_m: Floats
    sigma_m: Floats
    scores: Floats
    origin: Origins
    dynamics: Floats | None = None

    def __len__(self) -> int:
        return len(self.joints_m)

    @property
    def known(self) -> NDArray[np.bool_]:
        """`(num_slots, num_joints)`: which joints have a place."""
        return np.asarray(self.origin != MISSING)


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """The motion of all people over a range of slots.

    Attributes:
        name: what a person calls it.
        skeleton: of the joint axis.
        interval_s: seconds per slot.
        motions: one a person, by track id.
        started_ns: time of slot 0 since 1970, UTC; None if unknown.
    """

    name: str
    skeleton: Skeleton
    interval_s: float
    motions: tuple[Motion, ...]
    started_ns: int | None = None

    @property
    def fps(self) -> float:
        """Slots per second."""
        return 1.0 / self.interval_s

    @property
    def span(self) -> tuple[int, int]:
        """The first slot with somebody and the one after the last; (0, 0) with nobody."""
        if not self.motions:
            return 0, 0
        return min(m.first for m in self.motions), max(m.first + len(m) for m in self.motions)

    def dense(self) -> tuple[Floats, tuple[int, ...], int]:
        """Return all people in one array.

        Returns:
            `(num_slots, num_tracks, num_joints, 3)` world metres, NaN where missing; the track ids
            of its second axis; the slot of its first row.
        """
        first, end = self.span
        joints_m = np.full((end - first, len(self.motions), len(self.skeleton), 3), np.nan)
        for index, motion in enumerate(self.motions):
            begin = motion.first - first
            joints_m[begin : begin + len(motion), index] = motion.joints_m
        return joints_m, tuple(motion.track_id for motion in self.motions), first


def motions_of(slots: Integers, people: People) -> tuple[Motion, ...]:
    """Return rows of people as motions without gaps in their slots, by track id.

    Args:
        slots: `(num_rows,)` in any order, each once for a person.
        people: `(num_rows,)` of them in these slots.

    Raises:
        InputError: when a slot comes twice.
    """
    order = np.lexsort((slots, people.track_ids))
    ids, starts = np.unique(people.track_ids[order], return_index=True)
    parts = np.split(order, starts[1:]) if len(ids) else []
    return tuple(_motion_of(slots[rows], people[rows]) for rows in parts)


def nowhere(track_id: int, first: int, num_slots: int, num_joints: int) -> Motion:
    """Return the motion of somebody who is missing in all slots, to be filled.

    Raises:
        InputError: for more slots than fit into memory.
    """
    shape = num_slots, num_joints
    check_fit(f"track {track_id}", *shape)
    places, sigma = np.full((*shape, 3), np.nan), np.full(shape, np.nan)
    origin = np.full(shape, MISSING, dtype=np.uint8)
    return Motion(track_id, first, places, sigma, np.zeros(shape), origin)


def check_fit(who: str, num_slots: int, num_joints: int, place: str = "") -> None:
    """Raise `InputError` where somebody's slots, from the first to the last, fill the memory.

    Of several people `num_slots` is the sum. `place` is the file that has them.
    """
    if num_slots * num_joints > MAX_JOINTS_HELD:
        most = MAX_JOINTS_HELD // num_joints
        raise InputError(who, f"{num_slots} slots from first to last", f"at most {most}", place)


def _motion_of(slots: Integers, people: People) -> Motion:
    """Return the rows of one person, by rising slot."""
    track_id, rows = int(people.track_ids[0]), slots - slots[0]
    if (np.diff(slots) == 0).any():
        twice = int(slots[1:][np.diff(slots) == 0][0])
        raise InputError(f"track {track_id}: found slot {twice} twice, expected one row per slot")
    here: Flags = np.asarray(np.isfinite(people.joints_m).all(axis=-1))
    made = nowhere(track_id, int(slots[0]), int(rows[-1]) + 1, people.scores.shape[1])
    made.joints_m[rows] = np.where(here[..., None], people.joints_m, np.nan)
    made.sigma_m[rows] = np.where(here, people.sigma_m, np.nan)
    made.scores[rows] = np.where(here, people.scores, 0.0)
    made.origin[rows] = np.where(here, np.where(people.measured, MEASURED, PREDICTED), MISSING)
    if people.dynamics is None or not np.isfinite(people.dynamics).any():
        return made
    moving = np.full((*made.scores.shape, people.dynamics.shape[-1]), np.nan)
    moving[rows] = people.dynamics
    return replace(made, dynamics=moving)


def kept_rows(motion: Motion, keep: NDArray[np.bool_]) -> Motion:
    """Return a motion with some of its slots, one at least; others between them are missing.

    Args:
        motion: of one person.
        keep: `(num_slots,)`.
    """
    rows = np.flatnonzero(keep)
    part = slice(int(rows[0]), int(rows[-1]) + 1)
    gone = ~keep[part]
    values: dict[str, Any] = {}
    for name, missing in (("joints_m", np.nan), ("sigma_m", np.nan), ("scores", 0.0),
                          ("origin", MISSING), ("dynamics", np.nan)):  # fmt: skip
        if getattr(motion, name) is not None:
            values[name] = getattr(motion, name)[part].copy()
            values[name][gone] = missing
    return replace(motion, first=motion.first + part.start, **values)
