"""The smallest lead with which orders arrive in time, from measured delays."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

QUANTILE = 0.9  # of delays that are each the longest of half a second: 99 % of the orders, about
MAX_SAMPLES = 100  # some seconds of a few cameras: slow air must count soon
MIN_SAMPLES = 25
CALM_SLOTS = 250  # how long a smaller lead must have done before it is taken: hysteresis
MARGIN_SHARE = 0.1  # of a slot, to spare
MAX_LEAD = 60  # slots; the predictor sees no farther


@dataclass(frozen=True, slots=True)
class Lead:
    """How many slots ahead orders are given, and why; a value.

    Attributes:
        slots: the paper's tau, at least 1.
        delays_s: the newest delays from the middle of the slot that was looked at until the orders
            made from it had arrived, those of waking included; oldest first.
        calm: slots for which a smaller lead would have done.
    """

    slots: int = 1
    delays_s: tuple[float, ...] = ()
    calm: int = 0


def take_in_delay(lead: Lead, delay_s: float) -> Lead:
    """Return the lead with one more delay that was measured; one that cannot be is ignored."""
    if not (math.isfinite(delay_s) and 0 <= delay_s < 3600):
        return lead
    return replace(lead, delays_s=(*lead.delays_s, delay_s)[-MAX_SAMPLES:])


def cautious(deadline_s: float, interval_s: float) -> Lead:
    """Return the lead to begin with: enough even if every slot waits for its deadline."""
    slots = math.ceil(deadline_s / interval_s + 0.5 + MARGIN_SHARE)
    return Lead(min(max(slots, 1), MAX_LEAD))


def adapt(lead: Lead, interval_s: float, wake_s: float = 0.0) -> Lead:
    """Return the lead for the next slot.

    An order for slot t + lead, made from the views of slot t, must have arrived when slot t + lead
    begins, half a slot before its middle. The lead grows at once when that fails, and shrinks by
    one after `CALM_SLOTS` in which less would have done.

    Args:
        lead: of this slot.
        interval_s: seconds a slot.
        wake_s: how long the slowest camera takes to wake.

    Returns:
        The lead with `slots` in 1..`MAX_LEAD`.
    """
    if len(lead.delays_s) < MIN_SAMPLES:
        return lead
    delay_s = float(np.quantile(lead.delays_s, QUANTILE)) + wake_s
    needed = math.ceil(delay_s / interval_s + 0.5 + MARGIN_SHARE - 1e-9)
    needed = min(max(needed, 1), MAX_LEAD)
    if needed >= lead.slots:
        return replace(lead, slots=needed, calm=0)
    if lead.calm + 1 < CALM_SLOTS:
        return replace(lead, calm=lead.calm + 1)
    return replace(lead, slots=lead.slots - 1, calm=0)
