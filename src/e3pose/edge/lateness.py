"""Late views of a camera, and what they indicate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from e3pose.pipeline import SlotState
from e3pose.select.failure_detector import Silence, forgive, patience

# A camera without a view is told of when it was given up so often in a row, which takes 3 s: one
# that is not there at all is known to be away by then.
REPORTED_FAILURES = 3
LONG_S = 60.0  # a view that claims to be older has a wrong clock


def forgiven(
    state: SlotState,
    views_late: NDArray[np.bool_],
    orders_late: NDArray[np.bool_],
    interval_s: float,
) -> SlotState:
    """Return the state in which cameras are not thought dead because something came late.

    Args:
        state: of the loop, between two slots.
        views_late: `(num_cameras,)` of whom a view came too late since that was last asked.
        orders_late: `(num_cameras,)` who said last that orders came too late.
        interval_s: seconds a slot.
    """
    if not (views_late.any() or orders_late.any()):
        return state
    return replace(state, silence=forgive(state.silence, views_late, orders_late, interval_s))


def oddities(silence: Silence, late_by_s: NDArray[np.float64], interval_s: float) -> list[str]:
    """Return, camera by camera, why one that is there is of no use; empty where it is.

    Args:
        silence: who answers.
        late_by_s: `(num_cameras,)` how old the views were that came late; NaN where none did.
        interval_s: seconds a slot.
    """
    lives = silence.missed < patience(silence.loss, interval_s)
    return [
        _oddity(int(failures), bool(alive), float(age_s))
        for failures, alive, age_s in zip(silence.failures, lives, late_by_s, strict=True)
    ]


def _oddity(failures: int, alive: bool, age_s: float) -> str:
    if failures and alive and age_s < LONG_S:
        return f"views arrive too late, {age_s * 1e3:.0f} ms after capture"
    return "no views arrive in time" if failures >= REPORTED_FAILURES else ""
