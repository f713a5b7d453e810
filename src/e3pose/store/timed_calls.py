"""Calls to a database server with a time limit, as it may hang."""

from __future__ import annotations

import threading
from collections.abc import Callable

from e3pose.base.threads import show_thread_name


class TimedCalls:
    """Makes one call at a time, on a thread that it stops waiting for after a while."""

    def __init__(self, limit_s: float, cut: Callable[[], None]) -> None:
        """Start no thread yet.

        Args:
            limit_s: how long a call is waited for.
            cut: called where that was too long; makes the call fail soon, if anything can.
        """
        self.limit_s, self._cut = limit_s, cut
        self._running: threading.Thread | None = None

    def call(self, body: Callable[[], None], *, patient: bool = False) -> None:
        """Make a call; its exceptions propagate.

        Args:
            body: the call; no other one is made before it ends, whoever waits for it.
            patient: do not cut it, for what takes its time where all is well: an upgrade.

        Raises:
            TimeoutError: when it takes too long, or the one before it has not ended yet.
        """
        if self._running is not None:
            self._running.join(self.limit_s / 4)
            if self._running.is_alive():
                raise TimeoutError("no answer to an earlier call")
        errors: list[Exception] = []

        def run() -> None:
            show_thread_name()
            try:
                body()
            except Exception as error:
                errors.append(error)

        self._running = threading.Thread(target=run, name="store-call", daemon=True)
        self._running.start()
        self._running.join(self.limit_s)
        if self._running.is_alive():
            if not patient:
                self._cut()
            raise TimeoutError(f"no answer in {self.limit_s:g} s")
        self._running = None
        if errors:
            raise errors[0]
