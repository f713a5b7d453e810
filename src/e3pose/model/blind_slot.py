"""Blind slots: slots of a running site for which no view arrived although one was due.

A slot in which the policy selects no camera on purpose is not blind, nor is a slot that the edge
skips and never computes. Everything that counts, draws or stores blind slots uses this definition.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags
from e3pose.model.slot_record import SlotRecord

Cause = Literal["orders-late", "views-late", "views-missing", "cameras-offline"]
CAUSES: tuple[Cause, ...] = get_args(Cause)
WORDS: dict[str, str] = {
    "orders-late": "orders late",
    "views-late": "views late",
    "views-missing": "views missing",
    "cameras-offline": "no camera online",
}


def blind_cause(
    decided: Flags,
    online: Flags,
    arrived: bool,
    *,
    no_choice: str = "",
    in_time: bool = True,
    orders_late: Flags | None = None,
    views_late: Flags | None = None,
) -> str:
    """Return the cause of a blind slot; empty if it is not blind.

    Args:
        decided: `(num_cameras,)` cameras that the policy selected for the slot.
        online: `(num_cameras,)` cameras that could be reached in it.
        arrived: whether a view of it arrived in time.
        no_choice: why no camera could be selected when the policy decided, as `no_choice` says.
        in_time: whether the edge sent the orders before the slot began.
        orders_late: `(num_cameras,)` cameras that lately received orders too late; None for none.
        views_late: `(num_cameras,)` cameras whose newest view came too late; None for none.
    """
    if arrived:
        return ""
    if not online.any():
        return "cameras-offline"
    if not decided.any():
        return no_choice
    if not in_time:
        return "orders-late"
    asked = decided & online
    if not asked.any():
        return "cameras-offline"
    if views_late is not None and (asked & views_late).any():
        return "views-late"
    if orders_late is not None and (asked & orders_late).any():
        return "orders-late"
    return "views-missing"


def no_choice(online: Flags, answering: Flags, views_late: Flags) -> Cause | Literal[""]:
    """Return why no camera can be selected; empty if one can.

    Args:
        online: `(num_cameras,)` cameras that can be reached.
        answering: `(num_cameras,)` cameras that the failure detector has not given up.
        views_late: `(num_cameras,)` cameras whose newest view came too late.
    """
    if (online & answering).any():
        return ""
    if not online.any():
        return "cameras-offline"
    return "views-late" if (online & views_late).any() else "views-missing"


def seeing(records: Sequence[SlotRecord], num_cameras: int) -> Flags:
    """Return the selections that duty and savings are computed from: of slots that are not blind.

    In a blind slot cameras did not rest on purpose, so that it is no saving, whatever they drew.

    Args:
        records: one per slot.
        num_cameras: of the rig.

    Returns:
        `(num_slots, num_cameras)`.
    """
    selected = [record.selected for record in records if not record.blind]
    return np.array(selected, dtype=bool).reshape(-1, num_cameras)


def duty(records: Sequence[SlotRecord], num_cameras: int) -> NDArray[np.float64]:
    """Return `(num_cameras,)`: the share of the slots `seeing` in which each was selected."""
    return duty_of(seeing(records, num_cameras))


def duty_of(selected: Flags) -> NDArray[np.float64]:
    """Return the duty in the slots that `seeing` found; zeros where that is nothing."""
    return np.asarray(selected.mean(axis=0)) if len(selected) else np.zeros(selected.shape[1])


def count_blind(records: Sequence[SlotRecord]) -> dict[str, int]:
    """Return how many of the slots are blind, by cause; causes that did not occur are absent."""
    found = [record.blind for record in records]
    return {cause: found.count(cause) for cause in CAUSES if cause in found}


def blind_words(blind: Mapping[str, int]) -> str:
    """Return counts of blind slots in words: `3 orders late, 1 views missing`."""
    return ", ".join(f"{count} {WORDS.get(cause, cause)}" for cause, count in blind.items())
