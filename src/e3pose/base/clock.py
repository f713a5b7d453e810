"""Clocks, which are passed in, and the times of slots."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from typing import Protocol


class Clock(Protocol):
    """Say what time it is, in nanoseconds since 1970, and wait."""

    def now_ns(self) -> int:
        """Return the time; it never runs backwards."""
        ...

    def wait(self, event: threading.Event, until_ns: int) -> bool:
        """Wait until a time or until the event is set; return whether it is."""
        ...


@dataclass(frozen=True, slots=True)
class WallClock:
    """The time of day when it was made, and from then on steady, whatever sets the system's clock.

    Attributes:
        origin_ns: time of day minus the steady counter.
    """

    origin_ns: int = field(default_factory=lambda: time.time_ns() - time.monotonic_ns())

    def now_ns(self) -> int:
        """See `Clock.now_ns`."""
        return self.origin_ns + time.monotonic_ns()

    def wait(self, event: threading.Event, until_ns: int) -> bool:
        """See `Clock.wait`."""
        return event.wait(max(0.0, (until_ns - self.now_ns()) / 1e9))


@dataclass(frozen=True, slots=True)
class SlotTimes:
    """Where slots lie in the edge's time: slot 0 is around `origin_ns`.

    Attributes:
        origin_ns: the middle of slot 0.
        interval_ns: length of a slot.
    """

    origin_ns: int
    interval_ns: int

    def slot_at(self, edge_ns: int) -> int:
        """Return the slot that a time belongs to; negative before slot 0."""
        return (edge_ns - self.origin_ns + self.interval_ns // 2) // self.interval_ns

    def middle_ns(self, slot: int) -> int:
        """Return the time in the middle of a slot, to which its views are meant to belong."""
        return self.origin_ns + slot * self.interval_ns

    def begin_ns(self, slot: int) -> int:
        """Return when a slot begins: an order for it must have come."""
        return self.middle_ns(slot) - self.interval_ns // 2
