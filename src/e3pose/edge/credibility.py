"""What cameras say of themselves, against what the edge sees of them.

A camera with a valid certificate can say anything: that its orders come late, that it takes an hour
to wake. A word moves the lead, which is everybody's, only as far as the edge's own observation
allows: a camera that answers nearly all orders in time needs no longer lead, and one that answers
none is not followed. Cameras that seldom answer are neither selected nor waited for, except for
trials.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from e3pose.edge.lead import FAR_S, MARGIN_SHARE, MAX_DELAY_S, Lead, take_in_delay

Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]
Counts = NDArray[np.int64]

MEMORY_ORDERS = 32  # that the share of answered orders is averaged over
ANSWERING = 0.95  # share of answered orders with which a camera needs no longer lead
AWAITED = 0.75  # share of answered orders below which slots do not wait for a camera
RELIABLE = 0.5  # and below which it is not used
LEAST_RELIABLE = 2  # cameras, without which all are used: one sees no depth
TRIAL_S, TRIAL_EVERY_S = 1.0, 10.0  # for which such a camera is tried, and how often
SILENT_ORDERS = 5  # after so many without any view, each counts, also those not waited for
BLIND_SLOTS = 10  # in a row without any view: no camera is to blame
EXCUSED_S = 5.0  # of orders without a view, for which late orders are an excuse
# A camera given up so many times in a row is not followed by the lead, but for these attempts.
FIRST_ATTEMPTS, LATER_ATTEMPTS = 3, (4, 16, 64, 256, 1024)
USUAL_TIMES = 2.0  # a delay of so many times that of the others, or of a slot more, is usual
USUAL_WAKE_S = 0.5  # of a camera whose wake-up time is not configured


def after_orders(share: Floats, awaited: Flags, arrived: Flags) -> Floats:
    """Return the share of recent orders that each camera answered in time.

    Args:
        share: `(num_cameras,)` before the slot.
        awaited: `(num_cameras,)` cameras whose view the slot waited for.
        arrived: `(num_cameras,)` cameras whose view came in time.
    """
    return np.asarray(np.where(awaited, share + (arrived - share) / MEMORY_ORDERS, share))


def answers_enough(share: Floats, least: float, online: Flags, time_s: float) -> Flags:
    """Return `(num_cameras,)`: cameras that answer a share of their orders, or are on trial.

    Cameras on trial take turns. Where too few answer so much, all are returned.

    Args:
        share: `(num_cameras,)` of recent orders that each answered.
        least: the share asked for.
        online: `(num_cameras,)` cameras that can be reached.
        time_s: of the slot.
    """
    reliable = share >= least
    if (reliable & online).sum() < LEAST_RELIABLE:
        return np.ones(len(share), dtype=bool)
    since_s = (time_s + np.arange(len(share)) * TRIAL_S) % TRIAL_EVERY_S
    return np.asarray(reliable | (since_s < TRIAL_S))


def followed(failures: Counts) -> Flags:
    """Return `(num_cameras,)`: cameras whose delays the lead may follow.

    A camera that was given up again and again is not helped by a longer lead. It is followed for
    some attempts, farther and farther apart.

    Args:
        failures: `(num_cameras,)` how often in a row each was given up.
    """
    return np.asarray((failures < FIRST_ATTEMPTS) | np.isin(failures, LATER_ATTEMPTS))


def believed_delay_s(
    claim_s: float, others_s: Sequence[float], share: float, room_s: float, interval_s: float
) -> float:
    """Return the delay of orders to take for what a camera reports.

    Args:
        claim_s: the delay that it reports.
        others_s: those that count for other cameras.
        share: of recent orders that it answered in time.
        room_s: the longest delay that the present lead suffices for.
        interval_s: seconds per slot.

    Returns:
        The report, if it is usual or the camera misses orders. Otherwise at most what one slot
        less than the present lead has room for, so that the lead may shrink until it does; or the
        present lead, while no other camera has reported.
    """
    if share < ANSWERING:
        return claim_s
    if not others_s:
        return min(claim_s, max(room_s, 0.0))
    typical_s = lower_median(others_s)
    usual_s = max(USUAL_TIMES * typical_s, typical_s + interval_s)
    return min(claim_s, max(usual_s, room_s - interval_s))


def believed_wake_s(
    claim_s: float, others_s: Sequence[float], configured_s: float, share: float
) -> float:
    """Return the wake-up time to take for what a camera reports.

    Args:
        claim_s: the time that it reports.
        others_s: those that other cameras report.
        configured_s: that of the site file.
        share: of recent orders that it answered in time.

    Returns:
        At most the configured time or what is typical of the others; more, within limits, if the
        camera misses orders.
    """
    usual_s = max(configured_s, lower_median(others_s) if others_s else 0.0)
    limit_s = usual_s
    if share < ANSWERING:
        limit_s = max(min(usual_s + FAR_S, MAX_DELAY_S), usual_s)
    return min(claim_s, limit_s)


def lower_median(values: Sequence[float]) -> float:
    """Return the middle value, or the lower one of two: half of the sources cannot raise it."""
    return sorted(values)[(len(values) - 1) // 2]


class Credibility:
    """The observations of an edge; `claim` may be called on any thread, the rest on one."""

    def __init__(self, num_cameras: int, interval_s: float, wakes_s: Sequence[float] = ()) -> None:
        """Presume that all cameras answer.

        Args:
            num_cameras: of the rig.
            interval_s: seconds per slot.
            wakes_s: `(num_cameras,)` configured wake-up times; empty where none are.
        """
        self._num_cameras = num_cameras
        self.forgive()
        self._interval_s = interval_s
        self._wakes_s = tuple(wakes_s) or (USUAL_WAKE_S,) * num_cameras
        self._claims: deque[tuple[int, float]] = deque(maxlen=512)

    def forgive(self) -> None:
        """Presume again that all cameras answer."""
        self.share = np.ones(self._num_cameras)
        self._blind_slots = BLIND_SLOTS  # before the first view
        # Orders in a row without a view in time, and without any; views so far.
        self._unanswered = np.zeros(self._num_cameras, dtype=np.int64)
        self._silent, self._views = self._unanswered, self._unanswered

    def claim(self, camera: int, delay_s: float) -> None:
        """Add a delay of orders that a camera reports."""
        self._claims.append((camera, delay_s))

    def excused(self, orders_late: Flags) -> Flags:
        """Return `(num_cameras,)`: cameras whose late orders excuse that no view came."""
        return np.asarray(orders_late & (self._unanswered * self._interval_s < EXCUSED_S))

    def usable(self, online: Flags, slot: int) -> Flags:
        """Return `(num_cameras,)`: cameras to select and to use in a slot."""
        return answers_enough(self.share, RELIABLE, online, slot * self._interval_s)

    def awaited(self, ordered: Flags, online: Flags, slot: int) -> Flags:
        """Return `(num_cameras,)`: the ordered cameras that a slot waits for."""
        enough = answers_enough(self.share, AWAITED, online, slot * self._interval_s)
        used = ordered & online & self.usable(online, slot)
        return np.asarray(used & enough) if (used & enough).any() else used

    def impairments(self, others: Sequence[str]) -> list[str]:
        """Return for each camera why it is useless: another reason, or that it seldom answers."""
        return [
            why or (f"answers {share:.0%} of its orders in time" if share < RELIABLE else "")
            for why, share in zip(others, self.share.tolist(), strict=True)
        ]

    def observe(
        self, slot: int, ordered: Flags, online: Flags, arrived: Flags, views: Counts
    ) -> None:
        """Add a slot.

        Args:
            slot: which.
            ordered: `(num_cameras,)` cameras with an order in time.
            online: `(num_cameras,)` cameras that could be reached.
            arrived: `(num_cameras,)` cameras whose view came in time.
            views: `(num_cameras,)` views that came so far, in time or late.
        """
        ordered = ordered & online
        came, self._views = views > self._views, views.copy()
        self._silent = np.where(came, 0, self._silent + ordered)
        self._blind_slots = 0 if arrived.any() else self._blind_slots + 1
        if self._blind_slots < BLIND_SLOTS:
            silent = ordered & self.usable(online, slot) & (self._silent > SILENT_ORDERS)
            counted = self.awaited(ordered, online, slot) | silent
            self.share = after_orders(self.share, counted, arrived)
        self._unanswered = np.where(arrived, 0, self._unanswered + ordered)

    def lead_after_claims(self, lead: Lead, wake_s: float = 0.0) -> Lead:
        """Return the lead with the delays reported since the last call, as far as believed.

        Args:
            lead: before.
            wake_s: the time to wake that it has room for as well.
        """
        room_s = (lead.slots - 0.5 - MARGIN_SHARE) * self._interval_s - wake_s
        while self._claims:
            camera, claim_s = self._claims.popleft()
            others_s = [
                delay_s
                for other, delay_s in enumerate(lead.longest_s)
                if other != camera and not math.isnan(delay_s)
            ]
            share = float(self.share[camera])
            delay_s = believed_delay_s(claim_s, others_s, share, room_s, self._interval_s)
            lead = take_in_delay(lead, camera, delay_s)
        return lead

    def wake_s(self, claims_s: Sequence[float | None]) -> float:
        """Return the wake-up time of the slowest camera, as far as believed.

        Args:
            claims_s: `(num_cameras,)` times that cameras report; None for those that never sleep.
        """
        sleepers = {camera: claim_s for camera, claim_s in enumerate(claims_s) if claim_s}
        return max(
            (
                believed_wake_s(
                    claim_s,
                    [other_s for other, other_s in sleepers.items() if other != camera],
                    self._wakes_s[camera],
                    float(self.share[camera]),
                )
                for camera, claim_s in sleepers.items()
            ),
            default=0.0,
        )
