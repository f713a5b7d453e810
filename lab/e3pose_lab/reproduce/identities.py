"""Causes of identity changes: people who left, lost tracks, swaps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from e3pose.model.slot_record import SlotRecord
from e3pose.recording import Recording

FOUND_M = 0.5
KINDS = RETURNED, SWAPPED, LOST = "returned", "swapped", "lost"


def changes(recording: Recording, records: Sequence[SlotRecord]) -> Counter[str]:
    """Return how many changes of identity there are of each kind."""
    assert recording.truth is not None, "identities need a truth"
    found: Counter[str] = Counter()
    last: dict[int, int] = {}  # which number a person was shown with
    seen: dict[int, int] = {}  # in which slot
    away: dict[int, int] = {}  # in which slot a person was last not there
    owner: dict[int, int] = {}  # who was last shown with a number
    for slot, record in enumerate(records):
        truth = recording.truth.joints_m[slot]
        there = np.isfinite(truth).all(axis=(1, 2))
        away.update(dict.fromkeys(np.flatnonzero(~there).tolist(), slot))
        people = np.flatnonzero(there)
        apart = np.linalg.norm(record.poses.joints_m[:, None] - truth[people][None], axis=-1)
        if apart.size == 0:
            continue
        apart = np.nanmean(apart, axis=-1)
        rows, columns = linear_sum_assignment(np.minimum(apart, 2.0))
        near = apart[rows, columns] < FOUND_M
        for row, column in zip(rows[near], columns[near], strict=True):
            who, number = int(people[column]), int(record.track_ids[row])
            if last.get(who, number) != number:
                if away.get(who, -1) >= seen[who]:
                    found[RETURNED] += 1
                else:
                    found[SWAPPED if owner.get(number, who) != who else LOST] += 1
            last[who], seen[who], owner[number] = number, slot, who
    return found
