"""PCP of Shelf in three readings of its protocol."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from e3pose.evaluate.metrics import count_parts, pcp_percent
from e3pose.evaluate.summary import in_skeleton
from e3pose.model.pose import Poses3D
from e3pose.model.skeleton import SHELF14
from e3pose.model.slot_record import SlotRecord
from e3pose.recording import Recording


def pcp_readings(
    recording: Recording, records: Sequence[SlotRecord]
) -> dict[str, dict[str, float]]:
    """Return PCP of a replay without a memory in three readings of the protocol; {} without truth.

    Returns:
        By actor and `average`: `shown` with filled joints; `estimated` without them, a limb that
        lacks an end being wrong; `skipped` likewise, such a limb not being counted.
    """
    truth = recording.truth
    if truth is None or truth.skeleton != SHELF14:
        return {}
    first, stop = recording.scored_slots or (0, recording.num_slots)
    by_slot = {record.slot: record for record in records}
    scored = [by_slot.get(slot) for slot in range(first, stop)]
    shown = in_skeleton(scored, recording.skeleton, truth.skeleton)
    placed = in_skeleton(
        [None if record is None else _placed(record) for record in scored],
        recording.skeleton,
        truth.skeleton,
    )
    readings = {"estimated": (placed, False), "shown": (shown, False), "skipped": (placed, True)}
    return {
        name: pcp_percent(count_parts(people, truth.joints_m[first:stop], skip), truth.person_ids)
        for name, (people, skip) in readings.items()
    }


def _placed(record: SlotRecord) -> SlotRecord:
    """Return the record without the joints that were not estimated in its slot."""
    measured = record.measured
    joints_m = np.where(measured[..., None], record.poses.joints_m, np.nan)
    poses = Poses3D(joints_m, np.where(measured, record.poses.scores, 0.0))
    return replace(record, poses=poses)
