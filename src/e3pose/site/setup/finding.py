"""Possible sources: devices of this machine, films in a folder, typed addresses."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from urllib.parse import urlsplit

from e3pose.base.errors import InputError
from e3pose.base.masking import masked
from e3pose.camera.webcam import check_name
from e3pose.settings.limits import check_source
from e3pose.settings.sources import PHONE, place_of
from e3pose.site.setup.plan import ChosenCamera

FILMS = (".mp4", ".mkv", ".mov", ".avi", ".webm", ".m4v")
DEPTH, MOST_FILMS, MOST_ENTRIES = 4, 200, 20_000
STREAMS = ("rtsp", "rtsps", "http", "https")
DEVICES = ("usb", "picamera2", "imx500", "depthai")
MAX_SOURCE = 500


def find_films(folder: Path) -> list[str]:
    """Return the films in and below a folder, relative to it, without hidden ones."""
    found = sorted(_films(folder, DEPTH, [MOST_ENTRIES]))
    return [path.relative_to(folder).as_posix() for path in found[:MOST_FILMS]]


def _films(folder: Path, depth: int, left: list[int]) -> Iterator[Path]:
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError:
        return
    for entry in entries:
        left[0] -= 1
        if left[0] < 0:
            return
        if entry.name.startswith((".", "node_modules")) or entry.is_symlink():
            continue
        if entry.is_dir() and depth:
            yield from _films(Path(entry.path), depth - 1, left)
        elif entry.is_file() and entry.name.lower().endswith(FILMS):
            yield Path(entry.path)


def check_typed(source: str, folder: Path) -> str:
    """Return a source as a site file has it; files lie in a folder.

    Args:
        source: as typed or pasted.
        folder: in which set-up began: files elsewhere are not opened for a page.

    Raises:
        InputError: for what is no source, or a file elsewhere.
    """
    source = source.strip()
    if not (0 < len(source) <= MAX_SOURCE and source.isprintable()):
        raise InputError("source", repr(masked(source)[:60]), "usb:0, rtsp://HOST/PATH or a film")
    check_source(source)
    if source.startswith("gstreamer:"):
        raise InputError(
            "source", "a GStreamer pipeline", "it in site.toml: a pipeline may write files"
        )
    if source.startswith(PHONE):
        raise InputError("source", repr(masked(source)[:60]), "a phone by `Add a phone`")
    if "://" in source:
        parts = urlsplit(source)
        if parts.scheme not in STREAMS or not parts.hostname:
            found = repr(masked(source)[:60])
            raise InputError("source", found, "rtsp://HOST/PATH or http://HOST/PATH")
        return source
    place = place_of(source)
    if place is None:
        scheme, _, name = source.partition(":")
        if scheme not in DEVICES:  # no code of one's own for a page
            listed = ", ".join(f"{each}:NAME" for each in DEVICES)
            raise InputError("source", repr(masked(source)[:60]), f"one of {listed}")
        if scheme == "usb":
            check_name(name)
        return source
    path = (folder / place).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise InputError(
            "source", repr(place[:80]), f"a file in {folder}; start `e3pose setup` in a folder "
            "above your films"
        )  # fmt: skip
    if not path.exists():
        raise InputError(f"{path}: file not found, expected a film in {folder}")
    return f"{source[: len(source) - len(place)]}{path}"


def free_name(source: str, taken: Sequence[ChosenCamera]) -> str:
    """Return a name for the camera of a source: a film's own, else `cam` and a number."""
    names = {camera.id for camera in taken}
    place = place_of(source)
    stem = "" if place is None else re.sub(r"[^A-Za-z0-9_.-]", "_", Path(place).stem)[:60]
    if stem and stem[0] not in "-." and stem not in names:
        return stem
    return next(name for i in range(len(names) + 1) if (name := f"cam{i}") not in names)
