"""Problems of streams, shown to operators: small files beside the site file.

A stream is a viewer of the site: it can tell the edge nothing. It keeps a file in the folder
`stream-problems` while something is wrong; `e3pose top` and the page on the same machine read it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from e3pose.base.atomic import write_file
from e3pose.base.errors import InputError
from e3pose.base.private import make_folder

FOLDER = "stream-problems"
EVERY_S = 5.0  # a file is written again, so that one of a killed program is known to be old
FRESH_S = 20.0
MOST_FILES, MOST_LINES, MOST_TEXT = 16, 4, 200


class ProblemFile:
    """The file of this program; if it cannot be written, nothing is reported."""

    def __init__(self, site: Path) -> None:
        """Name the site file beside which it is."""
        self._path = site.parent / FOLDER / f"{os.getpid()}.txt"
        self._lines: tuple[str, ...] = ()
        self._due_s = -float("inf")

    def update(self, parts: Sequence[object]) -> None:
        """Write the present `problem` of each stream, if it has one; to be called often."""
        lines = tuple(one for part in parts if (one := getattr(part, "problem", "")))
        if lines == self._lines and (not lines or time.monotonic() < self._due_s):
            return
        self._lines, self._due_s = lines, time.monotonic() + EVERY_S
        with suppress(OSError, InputError):
            if not lines:
                self._path.unlink(missing_ok=True)
                return
            make_folder(self._path.parent)
            write_file(self._path, "\n".join(lines) + "\n", private=True)

    def close(self) -> None:
        """Remove the file."""
        self.update(())


def problems_of(site: Path) -> list[str]:
    """Return the problems of a site's streams on this machine, a line each."""
    found: list[str] = []
    with suppress(OSError):
        paths = sorted((site.parent / FOLDER).glob("*.txt"))[:MOST_FILES]
        for path in paths:
            with suppress(OSError):  # one that cannot be read hides no other
                if path.is_file() and time.time() - path.stat().st_mtime < FRESH_S:
                    found += lines_of(path, MOST_LINES)
    return found


def lines_of(path: Path, most: int) -> list[str]:
    """Return the first lines of another program's file, shortened and printable.

    Raises:
        OSError: where the file cannot be read.
    """
    with path.open(encoding="utf-8", errors="replace") as file:
        text = file.read(most * MOST_TEXT)
    lines = (line[:MOST_TEXT] for line in text.splitlines()[:most])
    return ["".join(c for c in line if c.isprintable()) for line in lines]
