"""Events of an edge: logged, shown in its status, and stored."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from e3pose.base.clock import Clock
from e3pose.edge.consumers import Sink
from e3pose.store.rows import Event

KEEP_EVENTS = 20


class EventLog:
    """The log of events; `report` and `add` may be called on any thread."""

    def __init__(self, clock: Clock, shown: Callable[[Event], None] = lambda event: None) -> None:
        """Start with no events.

        Args:
            clock: stamps the events.
            shown: called with every event, for logs.
        """
        self._recent: deque[Event] = deque(maxlen=KEEP_EVENTS)
        self._clock, self._shown = clock, shown
        self._sink: Sink | None = None
        self._lock = threading.Lock()

    @property
    def recent(self) -> tuple[Event, ...]:
        """A copy of the newest events, oldest first."""
        with self._lock:
            return tuple(self._recent)

    def report(self, kind: str, message: str, camera_id: str | None = None) -> None:
        """Log and store an event of now."""
        event = Event(self._clock.now_ns(), kind, message, camera_id)
        with self._lock:  # or an event of now could miss a sink that is attached now
            self._recent.append(event)
            if self._sink is not None:
                self._sink.event(event)
        self._shown(event)

    def add(self, event: Event) -> None:
        """Log an event that the store reported and has stored itself."""
        with self._lock:
            self._recent.append(event)
        self._shown(event)

    def attach(self, sink: Sink) -> None:
        """Store the events so far, and all later ones."""
        with self._lock:
            for event in self._recent:
                sink.event(event)
            self._sink = sink
