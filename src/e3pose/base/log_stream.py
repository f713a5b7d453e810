"""Standard output and error of programs that run for months: writing never fails and never waits.

A full disk, a closed pipe or a terminal that nobody reads must not stop a site. What cannot be
written is dropped and counted, and the count is written once there is room again.
"""

from __future__ import annotations

import atexit
import io
import json
import os
import sys
import threading
import time
from collections import deque

from e3pose.base.errors import reason_of
from e3pose.base.quantities import plural

QUEUE = 10_000  # lines that wait to be written
BATCH = 500  # lines that are written at once
END_S = 1.0  # for what waits when the program ends
SLOW = "its reader was too slow"


class LogStream(io.TextIOBase):
    """Text for an open file, written by a thread of its own.

    Attributes:
        as_json: whether its lines are JSON, and so the one about dropped lines.
    """

    encoding = "utf-8"
    errors = "backslashreplace"

    def __init__(self, handle: int) -> None:
        """Start the thread.

        Args:
            handle: of the file, which stays open.
        """
        self.as_json = False
        self._handle, self._parts = handle, deque[str]()
        self._more, self._lock, self._writing = threading.Event(), threading.RLock(), False
        self._dropped, self._why, self._torn = 0, "", False
        self._begun = ""  # of a line that has no end yet
        threading.Thread(target=self._work, name="log", daemon=True).start()
        atexit.register(self.drain)

    def fileno(self) -> int:
        """Return the handle."""
        return self._handle

    def isatty(self) -> bool:
        """Return whether a person sees it."""
        return os.isatty(self._handle)

    def writable(self) -> bool:
        """Return that it takes text."""
        return True

    def write(self, text: str) -> int:
        """Take text, or drop it where too much waits; a line is written when it is whole."""
        with self._lock:
            self._begun += text
        if "\n" in text:
            self.flush()
        return len(text)

    def flush(self) -> None:
        """Have the queued lines written soon, without waiting for it."""
        with self._lock:
            text, self._begun = self._begun, ""
        if len(self._parts) >= QUEUE:
            self._drop(text.count("\n"), SLOW)
        elif text:
            self._parts.append(text)
            self._more.set()

    def drain(self) -> None:
        """Wait until all is written, for a moment."""
        self.flush()
        until_s = time.monotonic() + END_S
        while (self._parts or self._writing) and time.monotonic() < until_s:
            time.sleep(0.002)

    def _work(self) -> None:
        while True:
            self._more.wait()
            self._more.clear()
            while self._parts:
                self._writing = True  # before the last one is taken
                count = min(len(self._parts), BATCH)
                self._put("".join(self._parts.popleft() for _ in range(count)))
                self._writing = False

    def _put(self, text: str) -> None:
        told = self._dropped
        whole = ("\n" if self._torn else "") + (self._note(told) if told else "") + text
        left = whole.encode(errors=self.errors)
        size = len(left)
        try:
            while left:
                left = left[os.write(self._handle, left) :]
        except OSError as error:
            self._torn = self._torn or len(left) < size
            self._drop(min(left.count(b"\n"), text.count("\n")), reason_of(error).lower())
            return
        self._torn = False
        with self._lock:
            self._dropped -= told

    def _drop(self, lines: int, why: str) -> None:
        with self._lock:
            self._dropped, self._why = self._dropped + lines, why

    def _note(self, count: int) -> str:
        said = f"{plural(count, 'line')} of this log dropped: {self._why}"
        return (json.dumps({"event": said, "level": "warning"}) if self.as_json else said) + "\n"


def outlast() -> None:
    """Replace standard output and error by streams that never fail and never wait."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is getattr(sys, f"__{name}__"):  # not what a test or a notebook put there
            stream.flush()
            setattr(sys, name, LogStream(stream.fileno()))


def drain() -> None:
    """Write what waits in standard output and error, before a program is ended at once."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, LogStream):
            stream.drain()
