"""Simulated sleep of a replay: cameras that oversleep. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from e3pose.base.arrays import Flags, Integers
from e3pose.energy.rest_costs import RestCosts
from e3pose.model.slot_record import SlotRecord

WAKING_STREAM = 11  # sets these draws apart from those of lost views


def awake_again(asleep_until: Integers, costs: RestCosts, interval_s: float, seed: int) -> Integers:
    """Return `(num_cameras,)` the slot from which cameras really are awake.

    Their alarms go off early enough for most of them; how long one wakes is drawn by seed, camera
    and slot alone.

    Args:
        asleep_until: `(num_cameras,)` the slot by the plan.
        costs: with the mean time to wake and its standard deviation.
        interval_s: seconds per slot.
        seed: of the draws.
    """
    draws = [
        np.random.default_rng([WAKING_STREAM, seed, camera, until]).standard_normal()
        for camera, until in enumerate(np.maximum(asleep_until, 0).tolist())
    ]
    took_s = np.maximum(costs.wake_s + costs.wake_sd_s * np.array(draws), 0.0)
    late_s = np.maximum(took_s - costs.alarm_s, 0.0)
    late = np.ceil(late_s / interval_s - 1e-9).astype(np.int64)
    return np.where(asleep_until > 0, asleep_until + late, 0)


def asleep_in(records: Sequence[SlotRecord], lead_slots: int) -> Flags:
    """Return `(num_slots, num_cameras)` who is asleep in each slot, by the plan.

    Args:
        records: one per slot, in order.
        lead_slots: slots between a decision and the slot that it is for.
    """
    until = np.stack([record.asleep_until for record in records])
    slots = np.array([record.slot for record in records])
    asleep = np.zeros(until.shape, dtype=bool)
    decided = until[: max(len(records) - lead_slots, 0)]
    asleep[lead_slots:] = decided > slots[lead_slots:, None]
    return asleep
