"""Events of an edge: logged, shown in its status, and stored."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from e3pose.edge.consumers import Sink
from e3pose.runtime.clock import Clock
from e3pose.store.rows import Event

KEEP_EVENTS = 20


class News:
    """Events; `tell` and `note` on any thread."""

    def __init__(self, clock: Clock, person: Callable[[Event], None] = lambda event: None) -> None:
        """Begin without any.

        Args:
            clock: the edge's.
            person: called with every event.
        """
        self.recent: deque[Event] = deque(maxlen=KEEP_EVENTS)
        self._clock, self._person = clock, person
        self._sink: Sink | None = None

    def tell(self, kind: str, message: str, camera_id: str | None = None) -> None:
        """Let people and the store know of something."""
        event = Event(self._clock.now_ns(), kind, message, camera_id)
        self.note(event)
        if self._sink is not None:
            self._sink.event(event)

    def note(self, event: Event) -> None:
        """Let people know of what the store told, which keeps that itself."""
        self.recent.append(event)
        self._person(event)

    def keep_in(self, sink: Sink) -> None:
        """Hand on what was told so far, and from now on all that is."""
        for event in self.recent:
            sink.event(event)
        self._sink = sink
