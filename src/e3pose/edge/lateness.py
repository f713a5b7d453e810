"""Late views of a camera, and what they indicate."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from e3pose.edge.inbox import NEAR_S
from e3pose.edge.lead import Lead, lagging
from e3pose.pipeline import SlotState
from e3pose.select.failure_detector import Silence, acknowledge_late, patience

# A camera without views is reported after so many failures in a row, which take 3 s: a camera that
# is disconnected is known to be offline by then.
REPORTED_FAILURES = 3
# One with late views after it was tried again: a link may stall for the 1.5 s that the first takes.
REPORTED_LATE_FAILURES = 2


def without_late_failures(
    state: SlotState,
    views_late: NDArray[np.bool_],
    orders_late: NDArray[np.bool_],
    interval_s: float,
) -> SlotState:
    """Return the state in which late views and late orders do not count as failures.

    Args:
        state: of the loop, between two slots.
        views_late: `(num_cameras,)` cameras with a late view since the last call.
        orders_late: `(num_cameras,)` cameras whose last heartbeat counted late orders.
        interval_s: seconds per slot.
    """
    if not (views_late.any() or orders_late.any()):
        return state
    return replace(
        state, silence=acknowledge_late(state.silence, views_late, orders_late, interval_s)
    )


def impairments(
    silence: Silence, late_by_s: NDArray[np.float64], interval_s: float, lead: Lead
) -> list[str]:
    """Return for each camera why it is useless although connected; empty if it is useful.

    Args:
        silence: of the failure detector.
        late_by_s: `(num_cameras,)` age of late views; NaN where none were late.
        interval_s: seconds per slot.
        lead: with the delays of orders.
    """
    lives = silence.missed < patience(silence.loss, interval_s)
    slow = lagging(lead)
    if 2 * len(slow) > sum(not math.isnan(delay_s) for delay_s in lead.longest_s):
        slow = {
            camera: f"orders take {lead.longest_s[camera]:.1f} s to arrive, as for most cameras: "
            "check the network"
            for camera in slow
        }
    found = zip(silence.failures, lives, late_by_s, strict=True)
    return [
        slow.get(camera) or _impairment(int(failures), bool(alive), float(age_s))
        for camera, (failures, alive, age_s) in enumerate(found)
    ]


def _impairment(failures: int, alive: bool, age_s: float) -> str:
    late = alive and age_s < NEAR_S  # otherwise its clock is wrong
    if failures >= REPORTED_LATE_FAILURES and late:
        return too_late(age_s)
    return "no views arrive in time" if failures >= REPORTED_FAILURES else ""


def too_late(age_s: float) -> str:
    """Return what is said of a camera whose views are so old when they arrive."""
    return f"views arrive too late, {age_s * 1e3:.0f} ms after capture"
