"""A one-element queue between two threads, in which the newest replaces the older."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

Thing = TypeVar("Thing")


class Box(Generic[Thing]):
    """A queue of one item: a newer one replaces it, and replaced ones are counted.

    Attributes:
        dropped: things that a newer one replaced.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._thing: Thing | None = None
        self._closed = self._dealing = False
        self._change = threading.Condition()

    @property
    def busy(self) -> bool:
        """Whether something is in it, or who took the last thing has not come back for another."""
        return self._thing is not None or self._dealing

    def put(self, thing: Thing) -> None:
        """Put an item into the box, replacing one that was not taken."""
        with self._change:
            self.dropped += self._thing is not None
            self._thing = thing
            self._change.notify()

    def take(self) -> Thing | None:
        """Wait for a thing and take it; None once the box is closed."""
        with self._change:
            self._dealing = False
            while self._thing is None and not self._closed:
                self._change.wait()
            self._dealing = True
            thing, self._thing = self._thing, None
            return None if self._closed else thing

    def close(self) -> None:
        """Wake up all waiting threads."""
        with self._change:
            self._closed = True
            self._change.notify_all()
