"""The orders of a camera by slot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from e3pose.base.clock import SlotTimes
from e3pose.model.expected import ExpectedView
from e3pose.wire.expected import expected_view
from e3pose.wire.messages import CameraMode, Order

KEPT_SLOTS = 4  # of the past: a frame may be dealt with after its slot
EARLY_SHARE = 0.3  # of a slot
TIE_SHARE = 0.2  # of a slot: more than frames jitter
# A shorter sleep saves less than to close and open the source takes; a longer least one keeps
# cameras awake in the gaps between their orders.
LEAST_SLEEP_NS = 300_000_000
BEHIND_NS = 1_000_000_000  # an order cannot come before it is sent
MAX_AHEAD = 2000  # orders for slots farther ahead are a mistake


@dataclass(frozen=True, slots=True)
class Schedule:
    """The orders of a camera; a value.

    Attributes:
        session: of the edge that gave them; 0 before the first.
        times: where slots lie; None before the first order.
        active: slot to whether to detect in it, for slots with an order.
        expected: slot to who is expected in it, for slots in which only that part is used.
        idle_mode: what to do otherwise.
        orders: how many came.
        late: how many came after their slot had begun, and so were ignored.
        asleep_from: the slot from which it is to sleep.
        asleep_until: the slot from which it is to be awake again; 0 to stay awake.
        wake_s: what it takes to wake, as the edge learned it; 0 where it did not.
        lead: slots from an order's making to its slot.
        sent_ns: when the newest of them was sent, edge time.
    """

    session: int = 0
    times: SlotTimes | None = None
    active: Mapping[int, bool] = field(default_factory=dict)
    expected: Mapping[int, ExpectedView] = field(default_factory=dict)
    idle_mode: CameraMode = "power-saving"
    orders: int = 0
    late: int = 0
    asleep_from: int = 0
    asleep_until: int = 0
    wake_s: float = 0.0
    lead: int = 1
    sent_ns: int = 0

    def is_active(self, slot: int) -> bool:
        """Return whether a slot is active; False without an order."""
        return self.active.get(slot, False)

    def next_active_ns(self, now_edge_ns: int) -> int | None:
        """Return the start of the next active slot, not before now; None if unknown.

        Args:
            now_edge_ns: the edge's time.
        """
        if self.times is None:
            return None
        here = self.times.slot_at(now_edge_ns)
        ahead = [slot for slot, active in self.active.items() if active and slot >= here]
        return max(now_edge_ns, self.times.begin_ns(min(ahead))) if ahead else None

    def free_s(self, now_edge_ns: int, newest_slot: int) -> float:
        """Return how long no frame is needed: until a slot that is active, or not ordered yet.

        Args:
            now_edge_ns: the edge's time.
            newest_slot: that has its frame.
        """
        if self.times is None:
            return 0.0
        slot = _slot_ahead(self.times, now_edge_ns, newest_slot)
        while self.active.get(slot) is False:
            slot += 1
        begin_ns = self.times.begin_ns(slot) - EARLY_SHARE * self.times.interval_ns
        return max(begin_ns - now_edge_ns, 0.0) / 1e9

    def alarm_ns(self, now_edge_ns: int, wake_s: float, asleep: bool = False) -> int | None:
        """Return when to wake from a sleep that is to begin or go on now; None to be awake.

        The camera is to be heard when its order for the slot after the sleep is made.

        Args:
            now_edge_ns: the edge's time.
            wake_s: what waking takes, where the edge has not learned it.
            asleep: whether it sleeps already; otherwise a short sleep is not worth it.
        """
        if self.times is None or not self.asleep_until:
            return None
        if now_edge_ns < self.times.begin_ns(self.asleep_from):
            return None
        if self.sent_ns - now_edge_ns > BEHIND_NS:
            return None  # what counts the camera's time stood still: its alarm is wrong
        due_ns = self.times.begin_ns(self.asleep_until - self.lead)
        alarm_ns = due_ns - round(1e9 * (self.wake_s or wake_s))
        least_ns = 1 if asleep else LEAST_SLEEP_NS
        return alarm_ns if alarm_ns - now_edge_ns >= least_ns else None


def take_order(schedule: Schedule, order: Order, now_edge_ns: int) -> Schedule:
    """Return the schedule after an order.

    An order of a newer edge forgets those of the one before. An order that comes after its slot
    began is counted and ignored: what the edge expects of that slot is decided already.
    """
    if order.session < schedule.session:
        return schedule
    times = SlotTimes(order.origin_edge_ns, order.interval_ns)
    fresh = order.session > schedule.session or times != schedule.times
    active = {} if fresh else dict(schedule.active)
    expected = {} if fresh else dict(schedule.expected)
    here = times.slot_at(now_edge_ns)
    late = now_edge_ns > times.begin_ns(order.slot)
    newest = fresh or order.sent_edge_ns >= schedule.sent_ns
    if not late and order.slot - here <= MAX_AHEAD:
        active[order.slot] = order.active
        expected.pop(order.slot, None)
        if (view := expected_view(order)) is not None:
            expected[order.slot] = view
    return replace(
        schedule,
        session=order.session,
        times=times,
        active={slot: detect for slot, detect in active.items() if slot >= here - KEPT_SLOTS},
        expected={slot: view for slot, view in expected.items() if slot >= here - KEPT_SLOTS},
        idle_mode=order.idle_mode,
        orders=schedule.orders + 1,
        late=schedule.late + late,
        **(_sleep_of(schedule, order) if newest else {}),
    )


def _sleep_of(schedule: Schedule, order: Order) -> dict[str, Any]:
    """Return when to sleep by the newest order, also by one that is late for its slot."""
    sleeps, goes_on = order.asleep_until > order.slot, order.asleep_until == schedule.asleep_until
    begins = min(schedule.asleep_from, order.slot) if goes_on else order.slot
    return {
        "asleep_from": begins if sleeps else 0,
        "asleep_until": order.asleep_until if sleeps else 0,
        "wake_s": order.wake_s,
        "lead": order.lead,
        "sent_ns": order.sent_edge_ns,
    }


def _slot_ahead(times: SlotTimes, edge_ns: int, newest_slot: int) -> int:
    """Return the slot that a frame of now may stand for, or the next one if that has its frame."""
    here = times.slot_at(edge_ns)
    # A slot that is far ahead was seen before the clock was found to be wrong.
    return here if newest_slot > here + 1 else max(here, newest_slot + 1)


def slot_of_frame(
    times: SlotTimes, edge_ns: int, newest_slot: int, frame_interval_ns: int
) -> int | None:
    """Return the slot that a frame stands for; None if another frame is the better one.

    Each slot has one frame: about the one nearest to its middle, as far as can be known when it
    comes. A camera whose frames fall on the border between slots must not leave every other slot
    empty, so a frame may stand for the slot after its own, and need not be nearer than the next
    one by a hair.

    Args:
        times: where slots lie.
        edge_ns: when the frame was taken, edge time.
        newest_slot: the slot of the frame before, in which nothing more is needed.
        frame_interval_ns: time to the next frame, about.
    """
    slot = _slot_ahead(times, edge_ns, newest_slot)
    if edge_ns < times.begin_ns(slot) - EARLY_SHARE * times.interval_ns:
        return None
    off_ns = abs(edge_ns - times.middle_ns(slot))
    next_off_ns = abs(edge_ns + frame_interval_ns - times.middle_ns(slot))
    return slot if off_ns <= next_off_ns + TIE_SHARE * times.interval_ns else None
