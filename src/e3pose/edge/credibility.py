"""What cameras say of themselves, against what the edge sees of them.

A camera with a valid certificate can say anything: that its orders come late, that it takes an hour
to wake. A word moves the lead, which is everybody's, only as far as the edge's own observation
allows: a camera that answers nearly all orders in time needs no longer lead, and one that answers
none is not followed. Cameras that seldom answer are neither selected nor waited for; see `trials`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.edge.lateness import too_late
from e3pose.edge.lead import (
    FAR_S,
    MARGIN_SHARE,
    MAX_DELAY_S,
    Lead,
    lead_for,
    lower_median,
    take_in_delay,
)
from e3pose.edge.trials import RELIABLE, Trials

MEMORY_ORDERS = 32  # that the share of answered orders is averaged over
ANSWERING = 0.95  # share of answered orders with which a camera needs no longer lead
AWAITED = 0.75  # share of answered orders below which slots wait for its usual time only
LEAST_RELIABLE = 2  # cameras, without which all are used: one sees no depth
SILENT_ORDERS = 5  # after so many without any view, slots do not wait
NEWEST_AGES, PATIENCE = 16, 1.5  # a view usually takes so many times the longest of the newest ages
BLIND_SLOTS = 10  # in a row without any view: no camera is to blame
EXCUSED_S = 5.0  # of orders without a view, for which late orders are an excuse
SELDOM_S = 5.0  # of too few answers before it is said: the lead follows slow orders in less
ATTEMPTS = 3  # a camera given up so many times in a row is not followed by the lead
USUAL_TIMES = 2.0  # a delay of so many times that of the others, or of a slot more, is usual
USUAL_WAKE_S = 0.5  # of a camera whose wake-up time is not configured


def after_orders(share: Floats, ordered: Flags, arrived: Flags) -> Floats:
    """Return the share of recent orders that each camera answered in time.

    Args:
        share: `(num_cameras,)` before the slot.
        ordered: `(num_cameras,)` cameras with an order in time.
        arrived: `(num_cameras,)` cameras whose view came in time.
    """
    return np.asarray(np.where(ordered, share + (arrived - share) / MEMORY_ORDERS, share))


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


def _seldom(share: float, age_s: float) -> str:
    if math.isnan(age_s):
        return f"answers {share:.0%} of its orders in time"
    return too_late(age_s)


class Credibility:
    """The observations of an edge.

    `claim` and `impairments`, which reads values that are replaced whole, may be called on any
    thread; the rest on one.
    """

    def __init__(self, num_cameras: int, interval_s: float, wakes_s: Sequence[float] = ()) -> None:
        """Presume that all cameras answer.

        Args:
            num_cameras: of the rig.
            interval_s: seconds per slot.
            wakes_s: `(num_cameras,)` configured wake-up times; empty where none are.
        """
        self._num_cameras, self._interval_s = num_cameras, interval_s
        self.forgive()
        self._wakes_s = tuple(wakes_s) or (USUAL_WAKE_S,) * num_cameras
        self._claims: deque[tuple[int, float]] = deque(maxlen=512)

    def forgive(self) -> None:
        """Presume again that all cameras answer."""
        self.share = np.ones(self._num_cameras)
        self.trials = Trials(self._num_cameras, self._interval_s)
        self._blind_slots = BLIND_SLOTS  # before the first view
        self._ages_s = [deque[float](maxlen=NEWEST_AGES) for _ in range(self._num_cameras)]
        # Orders in a row without a view in time, and without any; views so far.
        self._unanswered = np.zeros(self._num_cameras, dtype=np.int64)
        self._silent, self._views = self._unanswered, self._unanswered
        self._unreliable = self._unanswered  # slots in a row with too few answers

    def claim(self, camera: int, delay_s: float) -> None:
        """Add a delay of orders that a camera reports."""
        self._claims.append((camera, delay_s))

    def excused(self, orders_late: Flags) -> Flags:
        """Return `(num_cameras,)`: cameras whose late orders excuse that no view came."""
        return np.asarray(orders_late & (self._unanswered * self._interval_s < EXCUSED_S))

    def usable(self, online: Flags) -> Flags:
        """Return `(num_cameras,)`: cameras to select. Where too few answer enough, all are."""
        reliable = self.share >= RELIABLE
        enough = (reliable & online).sum() >= LEAST_RELIABLE
        return reliable if enough else np.ones(self._num_cameras, dtype=bool)

    def waits_s(self, ordered: Flags, online: Flags, deadline_s: float) -> Floats:
        """Return `(num_cameras,)`: how long after its middle a slot waits for each view, seconds.

        It waits until the deadline for cameras that answer most orders, and as long as their views
        usually take for the others. 0 for cameras without an order, and for those that have been
        silent for some orders, until a view comes.
        """
        longest_s = np.array([max(ages_s, default=math.inf) for ages_s in self._ages_s])
        usual_s = np.minimum(PATIENCE * longest_s, deadline_s)
        wait_s = np.where(self.share >= AWAITED, deadline_s, usual_s)
        awaited = ordered & online & (self._silent < SILENT_ORDERS)
        return np.where(awaited, wait_s, 0.0)

    def followed(self, failures: Integers) -> Flags:
        """Return `(num_cameras,)`: cameras whose delays the lead may follow.

        Args:
            failures: `(num_cameras,)` how often in a row each was given up.
        """
        return np.asarray((failures < ATTEMPTS) & (self.share >= RELIABLE))

    def trial(
        self, slot: int, online: Flags, lead: Lead, claims_s: Sequence[float | None]
    ) -> tuple[int, int] | None:
        """Plan an order for the camera to try now.

        Args:
            slot: the present one.
            online: `(num_cameras,)` cameras that can be reached.
            lead: the present one.
            claims_s: `(num_cameras,)` wake-up times that cameras report; None: it never sleeps.

        Returns:
            The camera, and how many slots ahead its order is for; None where none is to be tried.
        """
        camera = self.trials.whose(online & (self.share < RELIABLE), slot)
        if camera is None:
            return None
        ahead = lead_for(lead, camera, self._interval_s, self._wake_s(camera, claims_s))
        self.trials.plan(slot + ahead, camera)
        return camera, ahead

    def impairments(self, others: Sequence[str], late_by_s: Floats) -> list[str]:
        """Return for each camera why it is useless: another reason, or that it long answers seldom.

        Args:
            others: `(num_cameras,)` other reasons; empty where there is none.
            late_by_s: `(num_cameras,)` age of the newest view if it was late, else NaN.
        """
        seldom = (self._unreliable * self._interval_s >= SELDOM_S).tolist()
        found = zip(others, seldom, self.share.tolist(), late_by_s.tolist(), strict=True)
        return [why or (_seldom(share, age_s) if it else "") for why, it, share, age_s in found]

    def observe(
        self, slot: int, ordered: Flags, online: Flags, ages_s: Mapping[int, float], views: Integers
    ) -> None:
        """Add a slot.

        Args:
            slot: which.
            ordered: `(num_cameras,)` cameras with an order in time.
            online: `(num_cameras,)` cameras that could be reached.
            ages_s: by camera whose view came in time, from the middle of the slot until it came.
            views: `(num_cameras,)` views that came so far, in time or late.
        """
        ordered, arrived = ordered & online, np.zeros(self._num_cameras, dtype=bool)
        arrived[list(ages_s)] = True
        came, self._views = views > self._views, views.copy()
        for camera in np.flatnonzero(came | arrived).tolist():
            self._ages_s[camera].append(ages_s.get(camera, math.inf))
        self._silent = np.where(came, 0, self._silent + ordered)
        self._blind_slots = 0 if arrived.any() else self._blind_slots + 1
        if self._blind_slots < BLIND_SLOTS:
            self.trials.observe(slot, ordered & (self.share < RELIABLE), arrived)
            self.share = after_orders(self.share, ordered, arrived)
        self._unanswered = np.where(arrived, 0, self._unanswered + ordered)
        self._unreliable = np.where(self.share < RELIABLE, self._unreliable + 1, 0)

    def lead_after_claims(
        self, lead: Lead, wake_s: float = 0.0, followed: Sequence[bool] | None = None
    ) -> Lead:
        """Return the lead with the delays reported since the last call, as far as believed.

        Args:
            lead: before.
            wake_s: the time to wake that it has room for as well.
            followed: by camera, whether its delays count; None: all do.
        """
        room_s = (lead.slots - 0.5 - MARGIN_SHARE) * self._interval_s - wake_s
        counts = [True] * self._num_cameras if followed is None else followed
        while self._claims:
            camera, claim_s = self._claims.popleft()
            others_s = [
                delay_s
                for other, delay_s in enumerate(lead.longest_s)
                if other != camera and not math.isnan(delay_s) and counts[other]
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
        asleep = [camera for camera, claim_s in enumerate(claims_s) if claim_s]
        return max((self._wake_s(camera, claims_s) for camera in asleep), default=0.0)

    def _wake_s(self, camera: int, claims_s: Sequence[float | None]) -> float:
        """Return the wake-up time of a camera, as far as believed."""
        others_s = [s for other, s in enumerate(claims_s) if s and other != camera]
        configured_s, share = self._wakes_s[camera], float(self.share[camera])
        return believed_wake_s(claims_s[camera] or 0.0, others_s, configured_s, share)
