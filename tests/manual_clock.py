"""A clock that a test moves, so that ten minutes of a scenario run in a second."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field


@dataclass(slots=True, eq=False)
class ManualClock:
    """A clock that somebody else moves.

    Attributes:
        time_ns: what it shows.
    """

    time_ns: int = 0
    changed: threading.Condition = field(default_factory=threading.Condition)

    def now_ns(self) -> int:
        """See `Clock.now_ns`."""
        return self.time_ns

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        with self.changed:
            self.time_ns += round(seconds * 1e9)
            self.changed.notify_all()

    def wait(self, event: threading.Event, until_ns: int) -> bool:
        """See `Clock.wait`."""
        with self.changed:
            while self.time_ns < until_ns and not event.is_set():
                self.changed.wait(0.01)  # the event may be set without a word to us
        return event.is_set()
