"""Names of files in settings files: relative ones start from the folder of the file."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from e3pose.base.errors import InputError
from e3pose.base.plugins import beside as own_beside
from e3pose.base.plugins import is_own

T = TypeVar("T")


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
