"""Slots of a store as an edge published them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from e3pose.site.connect import LiveSlot
from e3pose.store.answers import StoredPoses, cut, joined


def stored_slots(chunks: Iterable[StoredPoses]) -> Iterator[tuple[int, LiveSlot]]:
    """Yield runs and slots with people, in order; which cameras looked is not among stored poses.

    Args:
        chunks: as `Store.read` yields them; a slot may lie in two.
    """
    held: StoredPoses | None = None
    for chunk in chunks:
        if held is not None and len(held):
            chunk = joined([held, chunk])
        if not len(chunk):
            continue
        begins = np.flatnonzero(
            np.diff(chunk.run_ids, prepend=chunk.run_ids[0] - 1) | np.diff(chunk.slots, prepend=-1)
        )
        for low, high in zip(begins[:-1].tolist(), begins[1:].tolist(), strict=True):
            yield _slot(chunk, low, high)
        held = cut(chunk, slice(int(begins[-1]), None))
    if held is not None and len(held):
        yield _slot(held, 0, len(held))


def _slot(poses: StoredPoses, low: int, high: int) -> tuple[int, LiveSlot]:
    time_ns = int(poses.time_ns[low])
    return int(poses.run_ids[low]), LiveSlot(
        int(poses.slots[low]),
        time_ns,
        poses.people[low:high],
        poses.joints,
        (),
        (),
        time_ns,
    )
