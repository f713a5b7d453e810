"""Publish the poses of a slot: at once, and optionally later, smoothed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    from e3pose.store.writer import WriterStatus


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
        self._joints, self._queue, self._clock = settings.joints, queue, clock
        self._camera_ids = np.array(rig.camera_ids, dtype=object)
        self._topic = topics.of_site(settings.site, "poses")
        self._delayed_topic = topics.of_site(settings.site, "poses-delayed")
        lag = lag_slots(settings.smooth_delay_s, interval_s)
        self._delay_s = lag * interval_s
        self._delayed = Delayed(settings.joints, lag) if settings.smooth_delay_s else None
        self._times_ns: dict[int, int] = {}  # of the slots that wait
        self._last_in_ns: dict[int, int] = {}  # slot to arrival of its last view, until published
        self._posterior: Posterior | None = None  # of the newest slot

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
        self._last_in_ns = {slot: max(*came_ns.values(), time_ns)} if came_ns else {}
        now_ns = self._clock.now_ns()
        message = poses_message(
            slot,
            estimate.people,
            self._joints,
            time_ns,
            now_ns,
            self._camera_ids[selected].tolist(),
            self._camera_ids[sorted(came_ns)].tolist(),
            blind,
            stored,
        )
        self._queue.put(self._topic, encode(message), slot)

    def warm_up(self) -> None:
        """Compile the kernels of delayed poses."""
        if self._delayed is not None:
            self._delayed.warm_up()

    def publish_delayed(self, record: SlotRecord, time_ns: int, busy: bool) -> int:
        """Publish an earlier slot, smoothed, unless the edge is busy; return the ns it took.

        Args:
            record: of the slot that was just published.
            time_ns: when it was.
            busy: whether the edge is; slots that wait are then never published.
        """
        if self._delayed is None or self._posterior is None:
            return 0
        if busy:
            self._delayed.forget()
            self._times_ns.clear()
            return 0
        begun_ns = self._clock.now_ns()
        self._times_ns[record.slot] = time_ns
        late = self._delayed.push(record, self._posterior)
        if late is not None:
            then_ns, now_ns = self._times_ns.pop(late.slot), self._clock.now_ns()
            message = poses_message(
                late.slot, late.people, self._joints, then_ns, now_ns, delay_s=self._delay_s
            )
            self._queue.put(self._delayed_topic, encode(message), late.slot)
        return self._clock.now_ns() - begun_ns

    def latency_ns(self, topic: str, slot: int) -> int | None:
        """Return the time since a slot's last view for people just sent; None of other topics."""
        last_ns = self._last_in_ns.pop(slot, None) if topic == self._topic else None
        return None if last_ns is None else self._clock.now_ns() - last_ns
