"""The smallest lead at which orders arrive in time, from measured delays.

Every camera reports its own delays. The lead follows the slowest camera, unless that one is far
slower than the others: then it is excluded instead of slowing down the site.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

QUANTILE = 0.9  # of delays that are each the longest of half a second: 99 % of the orders, about
MAX_SAMPLES = 20  # per camera, ten seconds: a slow wireless link must count soon
MIN_SAMPLES = 5
# How long a smaller lead must have sufficed before it is taken: hysteresis, doubled each time that
# it soon fails, so that the lead does not oscillate on a busy machine.
CALM_SLOTS, LONGEST_CALM_SLOTS = 250, 8000
SOON_SLOTS = 1000
MARGIN_SHARE = 0.1  # of a slot, safety margin
MAX_LEAD = 60  # slots; the horizon of the predictor
# Orders from two seconds ago are useless: a longer delay is not worth following, and a camera that
# reports one is not believed.
MAX_DELAY_S = 2.0
# A camera is excluded if its delay is so many times that of the others' median, and so much longer.
FAR_TIMES, FAR_S = 4.0, 0.5


@dataclass(frozen=True, slots=True)
class Lead:
    """How many slots ahead orders are given, and why; a value.

    Attributes:
        slots: the paper's tau, at least 1.
        delays_s: by camera, the newest delays from the middle of the slot that was looked at until
            the orders made from it had arrived; oldest first.
        longest_s: by camera, the `QUANTILE` of these; NaN while they are too few.
        calm: slots for which a smaller lead would have sufficed.
        wait: slots of calm after which the smaller one is taken.
        since_reduced: slots since the last reduction; at most `SOON_SLOTS`.
        left_behind: cameras excluded because they are far slower than the others.
    """

    slots: int = 1
    delays_s: tuple[tuple[float, ...], ...] = ()
    longest_s: tuple[float, ...] = ()
    calm: int = 0
    wait: int = CALM_SLOTS
    since_reduced: int = SOON_SLOTS
    left_behind: tuple[int, ...] = ()


def take_in_delay(lead: Lead, camera: int, delay_s: float) -> Lead:
    """Return the lead with one more delay that a camera measured; impossible ones are ignored."""
    if not (math.isfinite(delay_s) and delay_s >= 0):
        return lead
    new = camera + 1 - len(lead.delays_s)
    delays_s = [*lead.delays_s, *[()] * new]
    longest_s = [*lead.longest_s, *[math.nan] * new]
    delays_s[camera] = (*delays_s[camera], delay_s)[-MAX_SAMPLES:]
    if len(delays_s[camera]) >= MIN_SAMPLES:
        longest_s[camera] = _quantile_s(delays_s[camera])
    return replace(lead, delays_s=tuple(delays_s), longest_s=tuple(longest_s))


def _quantile_s(delays_s: Sequence[float]) -> float:
    """Return the `QUANTILE` of some delays; NumPy's takes longer than the rest of a heartbeat."""
    rising = sorted(delays_s)
    at = QUANTILE * (len(rising) - 1)
    low = int(at)
    high = min(low + 1, len(rising) - 1)
    return rising[low] + (at - low) * (rising[high] - rising[low])


def cautious(deadline_s: float, interval_s: float) -> Lead:
    """Return the initial lead: enough even if every slot waits for its deadline."""
    return Lead(_needed(min(deadline_s, MAX_DELAY_S), interval_s))


def adapt(
    lead: Lead, interval_s: float, wake_s: float = 0.0, online: Sequence[bool] | None = None
) -> Lead:
    """Return the lead for the next slot.

    An order for slot t + lead, made from the views of slot t, must have arrived when slot t + lead
    begins, half a slot before its middle. The lead grows at once when that fails, and shrinks by
    one after `wait` slots in which less would have done.

    Args:
        lead: of this slot.
        interval_s: seconds per slot.
        wake_s: how long the slowest camera takes to wake.
        online: by camera, whether it can be selected. Delays of others do not count, and are
            dropped: a camera that comes back runs another program, or uses another link.

    Returns:
        The lead with `slots` in 1..`MAX_LEAD`.
    """
    lead = _without_absent(lead, online)
    known = {c: delay_s for c, delay_s in enumerate(lead.longest_s) if not math.isnan(delay_s)}
    if not known:
        return lead
    limit_s = _limit_s(sorted(known.values()))
    behind = tuple(camera for camera, delay_s in known.items() if delay_s > limit_s)
    followed = [delay_s for camera, delay_s in known.items() if camera not in behind]
    if behind != lead.left_behind:
        lead = replace(lead, left_behind=behind)
    if not followed:
        return lead
    since_reduced = min(lead.since_reduced + 1, SOON_SLOTS)
    needed = _needed(max(followed) + wake_s, interval_s)
    if needed > lead.slots:
        too_early = since_reduced < SOON_SLOTS
        wait = min(2 * lead.wait, LONGEST_CALM_SLOTS) if too_early else CALM_SLOTS
        return replace(lead, slots=needed, calm=0, wait=wait, since_reduced=SOON_SLOTS)
    calm = lead.calm + 1 if needed < lead.slots else 0
    if calm >= lead.wait:
        return replace(lead, slots=lead.slots - 1, calm=0, since_reduced=0)
    return replace(lead, calm=calm, since_reduced=since_reduced)


def lagging(lead: Lead) -> dict[int, str]:
    """Return why each excluded camera is useless."""
    return {
        camera: f"too slow: orders take {lead.longest_s[camera]:.1f} s to arrive, "
        "far longer than for the others"
        for camera in lead.left_behind
    }


def _without_absent(lead: Lead, online: Sequence[bool] | None) -> Lead:
    if online is None or all(online[: len(lead.delays_s)]):
        return lead
    there = list(zip(lead.delays_s, lead.longest_s, online, strict=False))
    return replace(
        lead,
        delays_s=tuple(delays_s if here else () for delays_s, _, here in there),
        longest_s=tuple(longest_s if here else math.nan for _, longest_s, here in there),
        left_behind=tuple(camera for camera in lead.left_behind if online[camera]),
    )


def _needed(delay_s: float, interval_s: float) -> int:
    slots = math.ceil(delay_s / interval_s + 0.5 + MARGIN_SHARE - 1e-9)
    return min(max(slots, 1), MAX_LEAD)


def _limit_s(delays_s: Sequence[float]) -> float:
    """Return the delay above which cameras are too slow to be followed.

    It is measured from the lower median of the delays, which rise: half of the cameras can
    neither raise it nor be followed against the other half, one a little slower than the next.
    """
    typical_s = delays_s[(len(delays_s) - 1) // 2]
    return min(MAX_DELAY_S, max(FAR_TIMES * typical_s, typical_s + FAR_S))
