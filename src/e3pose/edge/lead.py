"""The smallest lead at which orders arrive in time, from measured delays.

Every camera reports its own delays. The lead follows the slowest camera, unless that one is far
slower than the others: then it is excluded instead of slowing down the site.

A camera with a valid certificate can say anything: that its orders come late, that it takes an hour
to wake. A word moves the lead, which is everybody's, only as far as the edge's own observation
allows: a camera that answers nearly all orders in time needs no longer lead.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.records import changed

# Of each camera, reports that are each the longest delay of half a second: the newest fifteen
# seconds. One in ten is left out, so that orders arrive in time in 98 of 100 slots, about, and that
# a link may pause for a second. Four long ones in a row, two seconds, always count.
MAX_SAMPLES, LEFT_OUT_OF = 30, 10
MIN_SAMPLES = 5
# So many newest reports, all of them this short for a camera that was slower: its disturbance is
# over, and older reports are dropped.
OVER_SAMPLES, OVER_SHARE = 12, 0.5
# A lead far above the need goes halfway down to it once per second; one near it waits, so that it
# does not oscillate. Both take twice as long each time that a reduction soon fails.
STEP_S = 1.0
CALM_S, LONGEST_CALM_S = 5.0, 160.0
SOON_S, SOON_WAITS = 40.0, 8.0  # soon: within the larger of these, the second times the wait
FAR_RAISE = 2.0  # a need that is so many times the lead before the reduction is a new disturbance
NEAR_SLOTS, NEAR_SHARE, VARYING_SHARE = 2, 0.25, 1.0  # above the need
# Delays are no property of a link while the edge, or its whole machine, stalls or starts: if orders
# leave so much later than the deadline of views, reports are not believed for a while. An edge that
# is late for longer is slow, and its lead must allow for that.
STALL_S, LONGEST_STALL_S = 0.25, 3.0
STALL_QUIET_S, START_QUIET_S = 1.5, 3.0
MARGIN_SHARE = 0.1  # of a slot, safety margin
MAX_LEAD = 60  # slots; the horizon of the predictor
# Orders from two seconds ago are useless: a longer delay is not worth following, and a camera that
# reports one is not believed.
MAX_DELAY_S = 2.0
# A camera is excluded if its delay is so many times that of the others' median, and so much longer.
FAR_TIMES, FAR_S = 4.0, 0.5
ANSWERING = 0.95  # share of answered orders with which a camera needs no longer lead
USUAL_TIMES = 2.0  # a delay of so many times that of the others, or of a slot more, is usual
USUAL_WAKE_S = 0.5  # of a camera whose wake-up time is not configured


@dataclass(frozen=True, slots=True)
class Lead:
    """The lead, in slots, and the delays behind it; a value.

    Attributes:
        slots: the paper's tau, at least 1.
        delays_s: by camera, the newest delays from the middle of the slot that was looked at until
            the orders made from it had arrived; oldest first.
        longest_s: by camera, the longest of these but for one in `LEFT_OUT_OF`; NaN while they are
            too few.
        calm_s: how long a smaller lead would have sufficed.
        peak: the largest need in that time, slots.
        wait_s: seconds of calm after which a lead near the need is reduced.
        reduced_from: the lead before the last reduction.
        since_reduced_s: since then.
        quiet_s: how long reports are not believed yet.
        stalled_s: slots in a row, in seconds, whose orders left too late.
        left_behind: cameras excluded because they are far slower than the others.
    """

    slots: int = 1
    delays_s: tuple[tuple[float, ...], ...] = ()
    longest_s: tuple[float, ...] = ()
    calm_s: float = 0.0
    peak: int = 0
    wait_s: float = CALM_S
    reduced_from: int = 0
    since_reduced_s: float = math.inf
    quiet_s: float = 0.0
    stalled_s: float = 0.0
    left_behind: tuple[int, ...] = ()


def take_in_delay(lead: Lead, camera: int, delay_s: float) -> Lead:
    """Return the lead with one more delay that a camera measured.

    Impossible ones are ignored, and so are all reports after a start or a stall of the edge.
    """
    if lead.quiet_s > 0 or not (math.isfinite(delay_s) and delay_s >= 0):
        return lead
    new = camera + 1 - len(lead.delays_s)
    delays_s = [*lead.delays_s, *[()] * new]
    longest_s = [*lead.longest_s, *[math.nan] * new]
    delays_s[camera] = _current((*delays_s[camera], delay_s)[-MAX_SAMPLES:], longest_s[camera])
    if len(delays_s[camera]) >= MIN_SAMPLES:
        longest_s[camera] = _longest_s(delays_s[camera])
    return replace(lead, delays_s=tuple(delays_s), longest_s=tuple(longest_s))


def _current(delays_s: tuple[float, ...], longest_s: float) -> tuple[float, ...]:
    """Return the delays without an ended disturbance."""
    newest_s = delays_s[-OVER_SAMPLES:]
    over = len(newest_s) == OVER_SAMPLES and max(newest_s) <= OVER_SHARE * longest_s
    return newest_s if over else delays_s


def _longest_s(delays_s: Sequence[float]) -> float:
    """Return the longest of some delays but for one in `LEFT_OUT_OF`."""
    return sorted(delays_s)[-1 - len(delays_s) // LEFT_OUT_OF]


def cautious(deadline_s: float, interval_s: float) -> Lead:
    """Return the initial lead: enough even if every slot waits for its deadline."""
    return starting(_needed(min(deadline_s, MAX_DELAY_S), interval_s))


def starting(slots: int) -> Lead:
    """Return an initial lead that ignores the reports of the first seconds."""
    return Lead(slots, quiet_s=START_QUIET_S)


def with_edge_delay(lead: Lead, late_s: float, interval_s: float) -> Lead:
    """Return the lead after the orders made from a slot left.

    Args:
        lead: before.
        late_s: from the deadline of the slot's views until its orders left.
        interval_s: seconds per slot.
    """
    if late_s <= STALL_S:
        return replace(lead, stalled_s=0.0) if lead.stalled_s else lead
    stalled_s = lead.stalled_s + interval_s
    quiet_s = STALL_QUIET_S if stalled_s <= LONGEST_STALL_S else lead.quiet_s
    return replace(lead, stalled_s=stalled_s, quiet_s=quiet_s)


def adapt(
    lead: Lead,
    interval_s: float,
    wake_s: float = 0.0,
    online: Sequence[bool] | None = None,
    followed: Sequence[bool] | None = None,
) -> Lead:
    """Return the lead for the next slot.

    An order for slot t + lead, made from the views of slot t, must have arrived when slot t + lead
    begins, half a slot before its middle. The lead grows at once when that fails. It shrinks by
    half of what it has too much every `STEP_S`, and to the need after `wait_s` once it is near.

    Args:
        lead: of this slot.
        interval_s: seconds per slot.
        wake_s: how long the slowest camera takes to wake.
        online: by camera, whether it can be reached. Delays of others do not count, and are
            dropped: a camera that comes back runs another program, or uses another link.
        followed: by camera, whether its delays count; None: all do.

    Returns:
        The lead with `slots` in 1..`MAX_LEAD`.
    """
    lead = _without_absent(lead, online)
    if lead.quiet_s > 0:
        lead = replace(lead, quiet_s=max(lead.quiet_s - interval_s, 0.0))
    lead, delay_s = _followed(lead, followed)
    if math.isnan(delay_s):
        return lead
    return _stepped(lead, _needed(delay_s + wake_s, interval_s), interval_s)


def lead_for(lead: Lead, camera: int, interval_s: float, wake_s: float = 0.0) -> int:
    """Return the slots ahead at which orders for one camera leave: the lead, or more if it is slow.

    Args:
        lead: the present one.
        camera: which.
        interval_s: seconds per slot.
        wake_s: how long it takes to wake.
    """
    known_s = sorted(delay_s for delay_s in lead.longest_s if not math.isnan(delay_s))
    if not known_s:
        return lead.slots
    own_s = lead.longest_s[camera] if camera < len(lead.longest_s) else math.nan
    delay_s = lower_median(known_s) if math.isnan(own_s) else min(own_s, _limit_s(known_s))
    return max(lead.slots, _needed(delay_s + wake_s, interval_s))


def lower_median(values: Sequence[float]) -> float:
    """Return the middle value, or the lower one of two: half of the sources cannot raise it."""
    return sorted(values)[(len(values) - 1) // 2]


def _followed(lead: Lead, followed: Sequence[bool] | None) -> tuple[Lead, float]:
    """Return the lead with the cameras that it excludes, and the longest delay of the others."""
    known = {
        camera: delay_s
        for camera, delay_s in enumerate(lead.longest_s)
        if not math.isnan(delay_s) and (followed is None or followed[camera])
    }
    if not known:
        return lead, math.nan
    limit_s = _limit_s(sorted(known.values()))
    behind = tuple(camera for camera, delay_s in known.items() if delay_s > limit_s)
    if behind != lead.left_behind:
        lead = replace(lead, left_behind=behind)
    return lead, max((d for camera, d in known.items() if camera not in behind), default=math.nan)


def _stepped(lead: Lead, needed: int, interval_s: float) -> Lead:
    """Return the lead, one slot later, by the number of slots that is needed now."""
    since_s = lead.since_reduced_s + interval_s
    if needed > lead.slots:
        return replace(
            lead, slots=needed, calm_s=0.0, peak=0, wait_s=_wait_s(lead, needed, since_s),
            since_reduced_s=math.inf,
        )  # fmt: skip
    if needed == lead.slots:
        return changed(lead, calm_s=0.0, peak=0, since_reduced_s=since_s)
    calm_s, peak = lead.calm_s + interval_s, max(lead.peak, needed)
    excess = lead.slots - peak
    share = NEAR_SHARE if lead.wait_s <= CALM_S else VARYING_SHARE
    near = excess <= max(NEAR_SLOTS, share * peak)
    wait_s = lead.wait_s if near else STEP_S
    if calm_s < wait_s - 1e-9:
        return changed(lead, calm_s=calm_s, peak=peak, since_reduced_s=since_s)
    slots = peak if near else peak + excess // 2
    return replace(
        lead, slots=slots, calm_s=0.0, peak=0, reduced_from=lead.slots, since_reduced_s=0.0
    )


def _wait_s(lead: Lead, needed: int, since_s: float) -> float:
    """Return the wait before the next reduction; longer if a raise follows the last one soon."""
    if math.isinf(since_s):
        return lead.wait_s  # none since the last raise: judged already
    if since_s > max(SOON_S, SOON_WAITS * lead.wait_s):
        return CALM_S
    failed = needed <= FAR_RAISE * lead.reduced_from
    return min(2 * lead.wait_s, LONGEST_CALM_S) if failed else lead.wait_s


def lagging(lead: Lead) -> dict[int, str]:
    """Return why each excluded camera is useless; if most are, the network is to blame."""
    known = sum(not math.isnan(delay_s) for delay_s in lead.longest_s)
    why = "too slow: orders take {:.1f} s to arrive, far longer than for the others"
    if 2 * len(lead.left_behind) > known:
        why = "orders take {:.1f} s to arrive, as for most cameras: check the network"
    return {camera: why.format(lead.longest_s[camera]) for camera in lead.left_behind}


def with_claims(
    lead: Lead,
    claims: Sequence[tuple[int, float]],
    share: Floats,
    interval_s: float,
    wake_s: float = 0.0,
    followed: Sequence[bool] | None = None,
) -> Lead:
    """Return the lead with the credible part of reported delays.

    Args:
        lead: before.
        claims: cameras and their delays of orders, seconds.
        share: `(num_cameras,)` of recent orders that each answered in time.
        interval_s: seconds per slot.
        wake_s: the time to wake that the lead has room for as well.
        followed: by camera, whether its delays count; None: all do.
    """
    room_s = (lead.slots - 0.5 - MARGIN_SHARE) * interval_s - wake_s
    for camera, claim_s in claims:
        others_s = [
            delay_s
            for other, delay_s in enumerate(lead.longest_s)
            if other != camera and not math.isnan(delay_s) and (not followed or followed[other])
        ]
        answered = float(share[camera])
        delay_s = _believed_delay_s(claim_s, others_s, answered, room_s, interval_s)
        lead = take_in_delay(lead, camera, delay_s)
    return lead


def _believed_delay_s(
    claim_s: float, others_s: Sequence[float], share: float, room_s: float, interval_s: float
) -> float:
    """Return the credible part of a camera's reported order delay.

    It is the report, if that is usual or the camera misses orders. Otherwise it is at most what one
    slot less than the present lead has room for, so that the lead may shrink until it does; or the
    present lead, while no other camera has reported.
    """
    if share < ANSWERING:
        return claim_s
    if not others_s:
        return min(claim_s, max(room_s, 0.0))
    typical_s = lower_median(others_s)
    usual_s = max(USUAL_TIMES * typical_s, typical_s + interval_s)
    return min(claim_s, max(usual_s, room_s - interval_s))


def believed_wakes_s(
    claims_s: Sequence[float | None], configured_s: Sequence[float], share: Floats
) -> Floats:
    """Return `(num_cameras,)`: credible wake-up times; 0 for awake cameras.

    At most the configured time or what is typical of the others; more, within limits, of a camera
    that misses orders.

    Args:
        claims_s: `(num_cameras,)` times that cameras report; None for those that never sleep.
        configured_s: `(num_cameras,)` those of the site file.
        share: `(num_cameras,)` of recent orders that each answered in time.
    """
    found_s = np.zeros(len(claims_s))
    for camera, claim_s in enumerate(claims_s):
        if claim_s:
            others_s = [s for other, s in enumerate(claims_s) if s and other != camera]
            limit_s = max(configured_s[camera], lower_median(others_s) if others_s else 0.0)
            if share[camera] < ANSWERING:
                limit_s = max(min(limit_s + FAR_S, MAX_DELAY_S), limit_s)
            found_s[camera] = min(claim_s, limit_s)
    return found_s


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
    typical_s = lower_median(delays_s)
    return min(MAX_DELAY_S, max(FAR_TIMES * typical_s, typical_s + FAR_S))
