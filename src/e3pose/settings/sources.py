"""Sources of cameras in settings files: which ones name a file or a folder, and where it is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from e3pose.base.errors import InputError

RECORDED = "recorded:"  # keypoints of a recording, no images
PHONE = "phone:"  # a phone that sends what its camera sees, by its file
DEVICES = ("usb:", "gstreamer:")


def is_recorded(source: str | None) -> bool:
    """Return whether a source plays the keypoints of a recording."""
    return (source or "").startswith(RECORDED)


def is_live(source: str) -> bool:
    """Return whether a source films now, in place of playing what was recorded."""
    return source.startswith(PHONE) or place_of(source) is None


def place_of(source: str) -> str | None:
    """Return the file or folder that a source names; None for a device or a stream.

    Raises:
        InputError: for a recording or a phone without a name.
    """
    if source == RECORDED:
        raise InputError("source", repr(source), "recorded:RECORDING, a recording's folder")
    if source == PHONE:
        raise InputError("source", repr(source), "phone:FILE, as `e3pose phone FILE` makes it")
    for kind in (RECORDED, PHONE):
        if source.startswith(kind):
            return source.removeprefix(kind)
    return None if "://" in source or source.startswith(DEVICES) else source


def shown_source(source: str, folder: Path) -> str:
    """Return a source as a settings file in a folder has it, in at most 60 characters."""
    return source.replace(f"{folder}/", "", 1)[:60]


def located(source: str, near: Callable[[str], Path]) -> str:
    """Return a source whose file or folder is given by its place.

    Args:
        source: as a settings file has it.
        near: finds places relative to that file.

    Raises:
        InputError: for a recording without a name.
    """
    place = place_of(source)
    if place is None:
        return source
    return f"{source[: len(source) - len(place)]}{near(place)}"
