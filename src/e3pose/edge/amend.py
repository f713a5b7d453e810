"""Amend the loop's state between slots: another lead, slots that nobody computed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.clock import SlotTimes
from e3pose.pipeline import SlotState
from e3pose.policies.base import Floats

AHEAD_SLOTS = 2  # a state from farther in the future is one whose clock went wrong


def still_true(times: SlotTimes, slot: int, now_ns: int, lead_slots: int) -> SlotTimes:
    """Return where slots lie; moved, if the machine's clock was set back since they were laid out.

    Args:
        times: where they lay.
        slot: the next to compute.
        now_ns: the time.
        lead_slots: slots between an order and the slot it is for.
    """
    if slot - times.slot_at(now_ns) <= AHEAD_SLOTS + lead_slots:
        return times
    next_ns = now_ns + (1 + lead_slots) * times.interval_ns
    return SlotTimes(next_ns - slot * times.interval_ns, times.interval_ns)


def with_lead(state: SlotState, lead_slots: int) -> SlotState:
    """Return the state for another lead.

    With a longer one the last decision also holds for the slots in between; with a shorter one
    the last decisions are made again.

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
    """Return the state before a later slot, after a time in which nothing was computed.

    Everybody may have moved, so all cameras look in the slots that were not decided for; cameras
    that did nothing meanwhile have saved up.

    Args:
        state: before the slots that are left out.
        slot: the next to compute.
        budget: `(num_cameras,)` share of slots allowed.
    """
    skipped = slot - state.slot
    if skipped <= 0:
        return state
    return replace(
        state,
        slot=slot,
        selections=np.ones_like(state.selections),
        deficit=np.maximum(state.deficit - skipped * budget, 0.0),
    )
