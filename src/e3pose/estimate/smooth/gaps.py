"""Find gaps in a joint's path, and interpolate the short ones, marked as filled."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.model.take import FILLED, MISSING, Motion


def stretches(known: Flags, longest_gap: int) -> Iterator[tuple[int, int]]:
    """Yield the first row and the one after the last of every stretch without gaps.

    Args:
        known: `(num_slots,)` whether the joint has a place.
        longest_gap: rows that may be missing within a stretch; 0 for none.
    """
    rows = np.flatnonzero(known)
    if len(rows) == 0:
        return
    breaks = np.flatnonzero(np.diff(rows) > longest_gap + 1)
    for first, last in zip(
        np.append(0, breaks + 1).tolist(), np.append(breaks, len(rows) - 1).tolist(), strict=True
    ):
        yield int(rows[first]), int(rows[last]) + 1


def fill_gaps(motion: Motion, longest_gap: int) -> Motion:
    """Return the motion with short gaps filled, and marked as filled.

    Between two known places a joint follows the monotone cubic through all known ones (Fritsch and
    Carlson 1980), which never swings beyond them. Nothing is filled before the first or after the
    last place of a joint.

    Args:
        motion: of one person.
        longest_gap: slots; 0 fills nothing.
    """
    if longest_gap <= 0:
        return motion
    from scipy.interpolate import PchipInterpolator

    joints_m, origin = motion.joints_m.copy(), motion.origin.copy()
    for joint in range(joints_m.shape[1]):
        known = motion.known[:, joint]
        for start, stop in stretches(known, longest_gap):
            inside = np.arange(start, stop)
            here, missing = inside[known[start:stop]], inside[~known[start:stop]]
            if len(missing):
                path = PchipInterpolator(here, motion.joints_m[here, joint])
                joints_m[missing, joint] = path(missing)
                origin[missing, joint] = FILLED
    filled = (origin == FILLED) & (motion.origin == MISSING)
    scores = np.where(filled, _between(motion.scores, filled), motion.scores)
    return replace(motion, joints_m=joints_m, scores=scores, origin=origin)


def _between(scores: Floats, filled: Flags) -> Floats:
    """Return scores with the lower one of a gap's two ends in the gap."""
    result: Floats = scores.copy()
    for joint in np.flatnonzero(filled.any(axis=0)).tolist():
        rows = np.flatnonzero(scores[:, joint] > 0)
        for row in np.flatnonzero(filled[:, joint]).tolist():
            after = int(np.searchsorted(rows, row))
            result[row, joint] = min(scores[rows[after - 1], joint], scores[rows[after], joint])
    return result
