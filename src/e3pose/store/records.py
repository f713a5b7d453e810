"""Read slots of a store back as slot records, for reports and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.model.blind_slot import blind_cause
from e3pose.model.slot_record import SlotRecord
from e3pose.store.answers import StoredPoses


def slot_records(
    rows: Sequence[Mapping[str, Any]],
    poses: StoredPoses,
    interval_s: float,
    first_slot: int = 0,
) -> list[SlotRecord]:
    """Return one record per row.

    Args:
        rows: of the table `slots` of one run, as `Store.rows` gives them.
        poses: of the same run and time.
        interval_s: seconds per slot.
        first_slot: the slot that becomes 0.
    """
    return [_record(row, poses, interval_s, first_slot) for row in rows]


def charged_j(rows: Sequence[Mapping[str, Any]]) -> Floats | None:
    """Return `(num_slots, num_cameras)` joules that slots are charged with; None where unknown.

    Args:
        rows: as of `slot_records`.
    """
    known = [row["energy_j"] for row in rows]
    return None if None in known or not known else np.array(known, dtype=np.float64)


def _record(
    row: Mapping[str, Any], poses: StoredPoses, interval_s: float, first_slot: int
) -> SlotRecord:
    low, high = np.searchsorted(poses.slots, [row["slot"], row["slot"] + 1])
    here, slot = slice(low, high), row["slot"] - first_slot
    people = poses.people[here]
    doubles = {
        name: getattr(people, name).astype(np.float64) for name in ("joints_m", "scores", "sigma_m")
    }
    return SlotRecord(
        slot=slot,
        time_s=slot * interval_s,
        selected=_flags(row["selected"]),
        arrived=_flags(row["arrived"]),
        people=replace(people, **doubles),
        occlusion=np.asarray(row["occlusion"], dtype=np.float64),
        deficit=np.asarray(row["deficit"], dtype=np.float64),
        next_selection=_flags(row["next_selection"]),
        stage_s={"step": row["took_s"]},
        blind=_blind(row),
    )


def _blind(row: Mapping[str, Any]) -> str:
    """Return the cause of a blind slot, inferred for records of older versions."""
    if row["blind"] is not None:
        return str(row["blind"])
    selected, arrived = _flags(row["selected"]), _flags(row["arrived"])
    return blind_cause(selected, np.ones_like(selected), bool(arrived.any()))


def _flags(text: str) -> NDArray[np.bool_]:
    return np.array([char == "1" for char in text])
