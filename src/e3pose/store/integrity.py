"""Check the integrity of a store's file now and then, within bounds."""

from __future__ import annotations

import sqlite3
import threading
import time
from contextlib import closing
from pathlib import Path

from e3pose.base.bounded import bytes_of
from e3pose.store.database import identity, is_damage, reading_uri

LIMIT_S = 30.0  # of one check: some 10 GB; of a larger database the first part is checked
SHARE = 0.02  # of a core, at most
SHRUNK_S = 5.0  # between checks at a file that keeps getting smaller


def problem_of(path: Path, limit_s: float = LIMIT_S) -> str:
    """Return the problem of an SQLite file's content; empty without one.

    Args:
        path: the file; it may be written meanwhile.
        limit_s: when to end, with what was found until then.
    """
    check = _Check(path)
    check.run(limit_s)
    return check.found()


class _Check:
    """One check of a file, which another thread may stop."""

    def __init__(self, path: Path) -> None:
        self.path, self.took_s = path, 0.0
        self._found = ""
        self._file = identity(path)
        self._connection: sqlite3.Connection | None = None
        self._ended = False

    def run(self, limit_s: float) -> None:
        """Check the file; store the problem found and the time taken."""
        begun_s = time.monotonic()
        timer = threading.Timer(limit_s, self.end)
        timer.daemon = True
        timer.start()
        try:
            self._found = self._check()
        finally:
            timer.cancel()
        self.took_s = time.monotonic() - begun_s

    def found(self) -> str:
        """Return the problem found, unless the file was replaced since."""
        return self._found if identity(self.path) == self._file else ""

    def end(self) -> None:
        """Stop the check; its findings so far remain."""
        self._ended = True
        if (connection := self._connection) is not None:
            connection.interrupt()

    def _check(self) -> str:
        try:
            with closing(sqlite3.connect(reading_uri(self.path), uri=True)) as connection:
                self._connection = connection
                found = "ok" if self._ended else _quick_check(connection)
                self._connection = None
        except sqlite3.Error as error:  # ended, locked, gone: then nothing is known
            return str(error) if is_damage(error) else ""
        return "" if found == "ok" else found


def _quick_check(connection: sqlite3.Connection) -> str:
    found = connection.execute("PRAGMA quick_check(1)").fetchone()
    return " ".join(str(found[0]).split())


class IntegrityWatch:
    """Checks the file of a store on its own thread; `check` starts it and never waits.

    Args:
        path: the file.
        every_s: seconds between two checks, or longer where they take long.
    """

    def __init__(self, path: Path, every_s: float) -> None:
        self.path, self.every_s = path, every_s
        self._due_s = self._shrank_s = 0.0
        self._size = 0
        self._current: _Check | None = None
        self._thread: threading.Thread | None = None

    def check(self) -> str:
        """Return the problem found by a finished check; start another one when due."""
        now_s = time.monotonic()
        if self._thread is not None and self._current is not None:
            if self._thread.is_alive():
                return ""
            self._thread = None
            self._due_s = now_s + max(self.every_s, self._current.took_s / SHARE)
            return self._current.found()
        if self._shrank(now_s) or now_s >= self._due_s:
            self._current = _Check(self.path)
            self._thread = threading.Thread(
                target=self._current.run, args=(LIMIT_S,), name="store-check", daemon=True
            )
            self._thread.start()
        return ""

    def close(self) -> None:
        """Stop a running check."""
        if self._thread is not None and self._current is not None:
            self._current.end()
            self._thread.join(timeout=5.0)

    def _shrank(self, now_s: float) -> bool:
        """Return whether the file was truncated, as retention rarely does, or replaced."""
        size, before = bytes_of(self.path), self._size
        if size < before and now_s < self._shrank_s + SHRUNK_S:
            return False
        self._size = size
        if size < before:
            self._shrank_s = now_s
        return size < before
