"""Threads of a program, which end together when one of them fails."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from e3pose.base.errors import Fault

MOST = 15  # characters that Linux keeps


def show_thread_name() -> None:
    """Give the running thread the name that it has in Python; does nothing beside Linux."""
    thread = threading.current_thread()
    try:
        # Opened to be changed, not made: elsewhere there is no such file.
        with Path(f"/proc/self/task/{thread.native_id}/comm").open("r+", encoding="utf-8") as file:
            file.write(thread.name[:MOST])
    except OSError:
        return


class ThreadGroup:
    """Threads that run until stopped."""

    def __init__(self, wake: Callable[[], Any]) -> None:
        """Start without threads.

        Args:
            wake: called when all must end, to wake threads that wait.
        """
        self.stopping = threading.Event()
        self.failure: BaseException | None = None
        self._wake = wake
        self._threads: dict[str, threading.Thread] = {}

    def start(self, name: str, body: Callable[[], Any]) -> None:
        """Start a thread."""
        thread = threading.Thread(target=self._guarded, args=(body,), name=name, daemon=True)
        self._threads[name] = thread
        thread.start()

    def running(self) -> bool:
        """Return whether all are still running."""
        return self.failure is None and not self.stopping.is_set()

    def check(self) -> None:
        """Raise `Fault` if one has failed."""
        if self.failure is not None:
            raise Fault(str(self.failure)) from self.failure

    def stop(self) -> bool:
        """Ask all to end; return False if they were already asked."""
        first = not self.stopping.is_set()
        self.stopping.set()
        return first

    def join(self, timeout_s: float, without: str = "") -> None:
        """Wait until all but one have ended, at most so long for each."""
        for name, thread in list(self._threads.items()):  # one may be started anew meanwhile
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
