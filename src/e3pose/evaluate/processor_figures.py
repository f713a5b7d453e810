"""Processor time of the cameras in a replay, from what was measured when they looked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from e3pose.base.arrays import Flags
from e3pose.energy.profiles import Mode
from e3pose.evaluate.figures import Processor
from e3pose.recording import Recording

if TYPE_CHECKING:
    from e3pose.pipeline import SlotRecord

NOT_MEASURED = "processor time of the cameras: not measured"


def processor_figures(
    recording: Recording, records: Sequence[SlotRecord], asleep: Flags | None, idle_mode: Mode
) -> Processor | None:
    """Return what looks and frames of the replay take; None unless all cameras were measured.

    Args:
        recording: with `processor`.
        records: one per slot.
        asleep: `(num_slots, num_cameras)` who captured nothing; None where everybody is awake.
        idle_mode: what cameras do that are not selected.
    """
    measured = [recording.processor.get(camera_id) for camera_id in recording.rig.camera_ids]
    known = [each for each in measured if each is not None]
    if not records or not known or len(known) < len(measured):
        return None
    look_s = np.array([each.look_s for each in known])
    frame_s = np.array([each.frame_s for each in known])
    looks = np.stack([record.selected for record in records])
    captures = looks if idle_mode == "aggressive-power-saving" else np.ones_like(looks)
    if asleep is not None:
        captures = (captures & ~asleep) | looks
    spent_s = float((looks * look_s + captures * frame_s).sum())
    every_s = float(len(records) * (look_s + frame_s).sum())
    if not every_s:
        return None
    return Processor(spent_s, every_s, 100 * (1 - spent_s / every_s))


def processor_words(processor: Processor | None) -> str:
    """Say what the cameras' processors take, and that it was measured, or that it was not."""
    if processor is None:
        return NOT_MEASURED
    return (
        f"processor time of the cameras, from measured looks and frames: {processor.spent_s:.1f} "
        f"s, {processor.saved_percent:.0f} % less than the {processor.every_slot_s:.1f} s of "
        "looking in every slot"
    )
