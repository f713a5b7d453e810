"""Choose the slot at which a report opens: typical, with moving people."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.model.camera import Rig
from e3pose.model.slot_record import SlotRecord

APART_M = 0.3  # between the middles of two people; nearer, one of them may not be there
ROUNDING = 1e-6


def opening_slot(rig: Rig, records: Sequence[SlotRecord]) -> int:
    """Return the index of the record to open a page at.

    It shows as many people as slots with anybody mostly do, each apart from the others, is not
    blind, and has cameras asleep, if such slots exist. Of these, half move less than at this moment
    at most, and its expected error is the nearest to their median; the middle one where nothing
    tells.
    """
    counts = np.array([len(record.people) for record in records], dtype=np.int64)
    if not counts.any():
        return 0
    often = np.bincount(counts[counts > 0])
    rows = np.flatnonzero(counts == len(often) - 1 - int(often[::-1].argmax()))
    apart = np.array([_apart(records[row]) for row in rows.tolist()])
    rows = _those(rows, apart)
    rows = _those(rows, np.array([not records[row].blind for row in rows.tolist()]))
    rows = _those(rows, np.array([records[row].selected.sum() < len(rig) for row in rows.tolist()]))
    speeds = np.array([_moved_m(records, row) for row in rows.tolist()])
    errors = np.array([_expected_m(records[row]) for row in rows.tolist()])
    known = np.isfinite(speeds) & np.isfinite(errors)
    if not known.any():
        return int(rows[len(rows) // 2])
    moving = known & (speeds >= (1 - ROUNDING) * np.median(speeds[known]))
    away = np.where(moving, np.abs(errors - np.median(errors[known])), np.inf)
    return int(rows[away.argmin()])


def _those(rows: NDArray[np.int64], wanted: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the rows that are wanted; all if none is."""
    return rows[wanted] if wanted.any() else rows


def _middles(record: SlotRecord) -> Floats:
    """Return `(num_persons, 3)` means of the joints of each person, metres."""
    joints = record.people.joints_m
    known = np.isfinite(joints).all(axis=-1, keepdims=True)
    total = np.where(known, joints, 0.0).sum(axis=1)
    return np.asarray(total / np.maximum(known.sum(axis=1), 1))


def _apart(record: SlotRecord) -> bool:
    middles = _middles(record)
    distance = np.linalg.norm(middles[:, None] - middles[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    return bool((distance >= APART_M).all())


def _moved_m(records: Sequence[SlotRecord], row: int) -> float:
    """Return how far the people of a slot have moved since the one before; NaN if unknown."""
    if row == 0:
        return np.nan
    before, now = records[row - 1], records[row]
    middles = dict(zip(before.people.track_ids.tolist(), _middles(before), strict=True))
    ids = now.people.track_ids.tolist()
    moved = [
        float(np.linalg.norm(middle - middles[track_id]))
        for track_id, middle in zip(ids, _middles(now), strict=True)
        if track_id in middles
    ]
    return float(np.mean(moved)) if moved else np.nan


def _expected_m(record: SlotRecord) -> float:
    """Return the mean expected error of the joints of a slot; NaN if unknown."""
    variance = np.trace(record.people.covariance_m2, axis1=-2, axis2=-1)
    known = np.isfinite(variance)
    return float(np.sqrt(variance[known]).mean()) if known.any() else np.nan
