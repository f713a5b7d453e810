"""The recordings that a running site made: which are there, and deleting one."""

from __future__ import annotations

import shutil
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import msgspec

from e3pose.base.bounded import bytes_of, read_toml
from e3pose.base.errors import InputError
from e3pose.edge.recorder import recordings_in
from e3pose.recording.folder import HEADER, MAX_HEADER_BYTES

NAME_TIME = "%Y%m%dT%H%M%SZ"  # as `edge.recorder` calls them
MOST = 500  # that are listed


@dataclass(frozen=True, slots=True)
class Kept:
    """A recording of a site.

    Attributes:
        name: of its folder.
        start_ns: when it began, nanoseconds since 1970; None where its name does not say it.
        seconds: how long it is.
        bytes: what it takes.
        videos: of how many cameras it has videos.
    """

    name: str
    start_ns: int | None
    seconds: float
    bytes: int
    videos: int


def kept_recordings(folder: Path) -> list[Kept]:
    """Return the newest readable recordings of a folder, newest first."""
    found = []
    for path in list(reversed(_recordings(folder)))[:MOST]:
        with suppress(InputError, OSError, KeyError, TypeError, ValueError, msgspec.MsgspecError):
            told = read_toml(path / HEADER, MAX_HEADER_BYTES)
            seconds = float(told["num_slots"]) / float(told["fps"])
            videos = len(told.get("videos", {}))
            found.append(Kept(path.name, _begun(path.name), seconds, bytes_of(path), videos))
    return found


def remove_recording(folder: Path, name: str) -> None:
    """Delete a recording; raise `InputError` for a name that none has."""
    for path in _recordings(folder):
        if path.name == name:
            shutil.rmtree(path)
            return
    raise InputError("recording", repr(name[:80]), "one of the site")


def _recordings(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return [path for path in recordings_in(folder) if not path.is_symlink()]


def _begun(name: str) -> int | None:
    try:
        when = datetime.strptime(name[:16], NAME_TIME).replace(tzinfo=timezone.utc)
    except ValueError:
        return None
    return round(when.timestamp()) * 10**9
