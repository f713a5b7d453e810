"""Publish the poses of a slot: at once, and optionally later, smoothed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from e3pose.base.clock import Clock
from e3pose.edge.reports import poses_message
from e3pose.edge.send_queue import SendQueue
from e3pose.estimate.base import Estimate, Posterior
from e3pose.estimate.smooth.delayed import Delayed, lag_slots
from e3pose.model.camera import Rig
from e3pose.pipeline import SlotRecord
from e3pose.settings.edge import EdgeSettings
from e3pose.wire import topics
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import Poses

if TYPE_CHECKING:
    from e3pose.store.writer import WriterStatus

MOST_WAITING = 250  # messages that wait to be stored: 10 s at 25 slots per second


class Waiting(NamedTuple):
    """A message that waits until its slot is stored."""

    slot: int
    topic: str
    message: Callable[[WriterStatus | None], Poses]
    last_ns: int | None  # when the last view of its slot arrived


class Publisher:
    """Queues the messages of people, and measures their latency."""

    def __init__(
        self,
        settings: EdgeSettings,
        rig: Rig,
        interval_s: float,
        queue: SendQueue,
        clock: Clock,
    ) -> None:
        """Start without people.

        Args:
            settings: of the edge.
            rig: the cameras.
            interval_s: of a slot.
            queue: the send queue.
            clock: the edge's.
        """
        self._joints, self._queue, self._clock = settings.skeleton.joints, queue, clock
        self._camera_ids = np.array(rig.camera_ids, dtype=object)
        self._topic = topics.of_site(settings.site, "poses")
        self._delayed_topic = topics.of_site(settings.site, "poses-delayed")
        lag = lag_slots(settings.smooth_delay_s, interval_s)
        self._delay_s = lag * interval_s
        self.delayed = Delayed(settings.skeleton, lag) if settings.smooth_delay_s else None
        self._times_ns: dict[int, int] = {}  # of the slots that wait
        self._last_in_ns: dict[int, int] = {}  # slot to arrival of its last view, until published
        self._posterior: Posterior | None = None  # of the newest slot
        self._waits = settings.publish_stored
        self._waiting: list[Waiting] = []
        self._stored: WriterStatus | None = None

    def publish(
        self,
        slot: int,
        time_ns: int,
        estimate: Estimate,
        came_ns: Mapping[int, int],
        selected: NDArray[np.bool_],
        blind: str = "",
        stored: WriterStatus | None = None,
    ) -> None:
        """Publish the people of a slot.

        Args:
            slot: which.
            time_ns: when it was.
            estimate: of the slot.
            came_ns: camera to arrival time of its view, of those selected.
            selected: `(num_cameras,)` selected cameras.
            blind: why the slot is blind; empty if it is not.
            stored: how the store is doing; None without one.
        """
        self._posterior = estimate.posterior
        if not self._waits or len(self._last_in_ns) > MOST_WAITING:
            self._last_in_ns.clear()
        last_ns = max(*came_ns.values(), time_ns) if came_ns else None
        chosen, came = self._camera_ids[selected].tolist(), self._camera_ids[sorted(came_ns)]

        def message(stored: WriterStatus | None) -> Poses:
            now_ns = self._clock.now_ns()
            return poses_message(
                slot,
                estimate.people,
                self._joints,
                time_ns,
                now_ns,
                chosen,
                came.tolist(),
                blind,
                stored,
            )

        self._put(Waiting(slot, self._topic, message, last_ns), stored)

    def _put(self, made: Waiting, stored: WriterStatus | None) -> None:
        """Queue a message, or the messages whose slots are stored by now."""
        ready = [made]
        if self._waits:
            lost = stored is None or self._stored is None or stored.shed > self._stored.shed
            known = [] if lost else self._waiting  # which of them were given up, nobody knows
            waiting = [*known, made][-MOST_WAITING:]
            newest = -1 if stored is None else stored.acknowledged_slot
            ready = [each for each in waiting if each.slot <= newest]
            self._waiting, self._stored = [each for each in waiting if each.slot > newest], stored
        for each in ready:
            if each.last_ns is not None:
                self._last_in_ns[each.slot] = each.last_ns
            self._queue.put(each.topic, encode(each.message(stored)), each.slot)

    def publish_delayed(self, record: SlotRecord, time_ns: int, busy: bool) -> int:
        """Publish an earlier slot, smoothed, unless the edge is busy; return the ns it took.

        Args:
            record: of the slot that was just published.
            time_ns: when it was.
            busy: whether the edge is; slots that wait are then never published.
        """
        if self.delayed is None or self._posterior is None:
            return 0
        if busy:
            self.delayed.forget()
            self._times_ns.clear()
            return 0
        begun_ns = self._clock.now_ns()
        self._times_ns[record.slot] = time_ns
        late = self.delayed.push(record, self._posterior)
        if late is not None:
            then_ns, people = self._times_ns.pop(late.slot), late.people

            def message(_: WriterStatus | None) -> Poses:
                now_ns = self._clock.now_ns()
                return poses_message(
                    late.slot, people, self._joints, then_ns, now_ns, delay_s=self._delay_s
                )

            self._put(Waiting(late.slot, self._delayed_topic, message, None), self._stored)
        return self._clock.now_ns() - begun_ns

    def latency_ns(self, topic: str, slot: int) -> int | None:
        """Return the time since a slot's last view for people just sent; None of other topics."""
        last_ns = self._last_in_ns.pop(slot, None) if topic == self._topic else None
        return None if last_ns is None else self._clock.now_ns() - last_ns
