"""Files and sources of cameras that settings files name: where they are, from the file's folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from e3pose.base.errors import InputError
from e3pose.base.plugins import beside as own_beside
from e3pose.base.plugins import is_own

T = TypeVar("T")

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


def near(folder: Path, name: str | Path) -> Path:
    """Return the place that a name means, relative to a folder; `~` is the user's home.

    Raises:
        InputError: for a name that cannot be shown, or an unknown user's home.
    """
    shown = str(name)
    if not shown.isprintable():
        raise InputError("", repr(shown[:80]), "the name of a file or folder")
    try:
        return folder / Path(name).expanduser()
    except RuntimeError:  # `~somebody`
        raise InputError("", repr(shown[:80]), "the home of a user there is") from None


def beside(folder: Path, name: str) -> str:
    """Return a name, or the file in a folder that it means."""
    if is_own(name):
        return own_beside(name, folder)
    file = near(folder, name)
    return str(file) if file.is_file() else name


def placed(record: T, folder: Path) -> T:
    """Return settings with every path made relative to a folder, in their tables too.

    Raises:
        InputError: naming the key whose path is none.
    """
    found: dict[str, Any] = {}
    for item in fields(record):  # type: ignore[arg-type]
        key, value = item.metadata.get("key"), getattr(record, item.name)
        if key != "":
            try:
                found[item.name] = _placed(value, folder)
            except InputError as error:
                raise error.under(key or item.name) from None
    return replace(record, **found)  # type: ignore[type-var]


def _placed(value: Any, folder: Path) -> Any:
    if isinstance(value, Path):
        return near(folder, value)
    if isinstance(value, tuple):
        return tuple(_placed(each, folder) for each in value)
    return placed(value, folder) if is_dataclass(value) else value
