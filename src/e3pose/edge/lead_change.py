"""Change the lead between slots, and advance the state over skipped slots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.clock import SlotTimes
from e3pose.pipeline import SlotState

AHEAD_SLOTS = 2  # a state from farther in the future was saved with a wrong clock
LONGEST_AWAY_S = 60.0  # age of a state whose slots and people are still current


def still_true(times: SlotTimes, slot: int, now_ns: int, lead_slots: int) -> tuple[SlotTimes, str]:
    """Return the slot times, and why they were moved; empty if they were not.

    They are moved if the machine's clock was set back, or if so much time seems to have passed
    that it may have been set forward: slot numbers continue with the next one.

    Args:
        times: before.
        slot: the next to compute.
        now_ns: the time.
        lead_slots: slots between an order and the slot it is for.
    """
    away_ns = now_ns - times.middle_ns(slot)
    ahead = slot - times.slot_at(now_ns)
    if ahead <= AHEAD_SLOTS + lead_slots and away_ns <= LONGEST_AWAY_S * 1e9:
        return times, ""
    next_ns = now_ns + (1 + lead_slots) * times.interval_ns
    moved = SlotTimes(next_ns - slot * times.interval_ns, times.interval_ns)
    if away_ns < 0:
        return moved, f"this machine's clock went back by {lasting(-away_ns / 1e9)}"
    return moved, f"{lasting(away_ns / 1e9)} since the last slot, by this machine's clock"


def lasting(seconds: float) -> str:
    """Return a duration in a convenient unit: `3.2 s`, `45 min`, `10.0 years`."""
    for unit, length_s in (("years", 365.25 * 86400), ("days", 86400.0), ("h", 3600.0)):
        if seconds >= 2 * length_s:
            return f"{seconds / length_s:.1f} {unit}"
    return f"{seconds / 60:.0f} min" if seconds >= 600 else f"{seconds:.1f} s"


def with_lead(state: SlotState, lead_slots: int) -> SlotState:
    """Return the state for another lead.

    A longer lead extends the last decision to the slots in between; a shorter one repeats the
    last decisions.

    Args:
        state: before a slot.
        lead_slots: slots between a decision and the slot it is for, at least 1.
    """
    decided = state.selections
    missing = lead_slots - len(decided)
    if missing <= 0:
        return replace(state, selections=decided[:lead_slots])
    return replace(state, selections=np.concatenate([decided, np.repeat(decided[-1:], missing, 0)]))


def skip_to(state: SlotState, slot: int, budget: Floats) -> SlotState:
    """Return the state before a later slot, after slots that were not computed.

    People may have moved, so all cameras that are awake are active in slots without a decision;
    idle cameras have saved energy meanwhile.

    Args:
        state: before the skipped slots.
        slot: the next to compute.
        budget: `(num_cameras,)` share of slots allowed.
    """
    skipped = slot - state.slot
    if skipped <= 0:
        return state
    slots = np.arange(slot, slot + len(state.selections))
    return replace(
        state,
        slot=slot,
        selections=np.asarray(state.asleep_until <= slots[:, None]),
        deficit=np.maximum(state.deficit - skipped * budget, 0.0),
    )
