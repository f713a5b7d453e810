"""The threads of an edge, which end together when one of them fails."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from e3pose.runtime.thread_name import show_thread_name


class Crew:
    """Threads that work until they are told to stop."""

    def __init__(self, wake: Callable[[], Any]) -> None:
        """Begin with nobody.

        Args:
            wake: called when all are to end, for those that wait for something else.
        """
        self.stopping = threading.Event()
        self.failure: BaseException | None = None
        self._wake = wake
        self._threads: dict[str, threading.Thread] = {}

    def start(self, name: str, body: Callable[[], Any]) -> None:
        """Let a thread do something."""
        thread = threading.Thread(target=self._guarded, args=(body,), name=name, daemon=True)
        self._threads[name] = thread
        thread.start()

    def running(self) -> bool:
        """Return whether all still work."""
        return self.failure is None and not self.stopping.is_set()

    def stop(self) -> bool:
        """Tell all to end; return whether they were not told before."""
        first = not self.stopping.is_set()
        self.stopping.set()
        return first

    def join(self, timeout_s: float, without: str = "") -> None:
        """Wait until all have ended, so long for each; leave one out."""
        for name, thread in self._threads.items():
            if name != without:
                thread.join(timeout=timeout_s)

    def _guarded(self, body: Callable[[], Any]) -> None:
        show_thread_name()
        try:
            body()
        except BaseException as error:  # the program must end with it, not go on half
            self.failure = error
            self.stopping.set()
            self._wake()
