"""The version of files that other programs replace while this one runs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

Version = tuple[int, ...]


def version_of(paths: Iterable[Path]) -> Version | None:
    """Return what changes whenever one of the files is replaced; None while one is missing."""
    try:
        found = [path.stat() for path in paths]
    except OSError:
        return None
    return tuple(number for status in found for number in (status.st_mtime_ns, status.st_ino))
