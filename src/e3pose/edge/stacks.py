"""Dump the stacks of all threads of a program to one of a few files."""

from __future__ import annotations

import faulthandler
import os
from pathlib import Path

from e3pose.base.private import file_mode, make_folder
from e3pose.base.system import open_new

MAX_FILES = 5  # the oldest is replaced
MAX_BYTES = 256 * 1024


def dump_stacks(folder: Path, program: str) -> Path:
    """Write the stacks of all threads to a file of a folder; return the file.

    Args:
        folder: where the program's logs are; made if it does not exist.
        program: begins the file's name.

    Raises:
        OSError: when the file cannot be written.
    """
    make_folder(folder)
    places = [folder / f"{program}-stacks-{number}.txt" for number in range(1, MAX_FILES + 1)]
    path = min(places, key=lambda place: place.stat().st_mtime_ns if place.exists() else 0)
    path.unlink(missing_ok=True)
    handle = open_new(path, file_mode(folder))
    try:
        faulthandler.dump_traceback(handle, all_threads=True)
        os.ftruncate(handle, min(os.fstat(handle).st_size, MAX_BYTES))
    finally:
        os.close(handle)
    return path
