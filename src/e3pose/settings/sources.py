"""Files and sources of cameras that settings files name: where they are, from the file's folder."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from e3pose.base.atomic import write_file
from e3pose.base.errors import MISSING, InputError
from e3pose.base.masking import has_secret, masked
from e3pose.base.plugins import beside as own_beside
from e3pose.base.plugins import is_own
from e3pose.base.private import make_folder, read_secret

T = TypeVar("T")

RECORDED = "recorded:"  # keypoints of a recording, no images
PHONE = "phone:"  # a phone that sends what its camera sees, by its file
SECRET = "secret:"  # a private file whose one line is the address of a camera, with its password
ENVIRONMENT = "env:"  # likewise a variable of the environment
# Devices that detect.
SENSORS = re.compile(r"imx500:|depthai:[^?]*\?model=")
SECRETS = "secrets"  # folder of a site for such files
# Two characters at least: `C:` is a drive. A file of such a name is written `./NAME`.
SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9_.+-]+):")
OWN_FILE = re.compile(r".+\.py:[A-Za-z_]\w*")  # a source of one's own, in a file


def is_recorded(source: str | None) -> bool:
    """Return whether a source plays the keypoints of a recording."""
    return (source or "").startswith(RECORDED)


def detects(source: str | None) -> bool:
    """Return whether a source brings poses, so that its camera runs no network."""
    return is_recorded(source) or SENSORS.match(source or "") is not None


def scheme_of(source: str) -> str:
    """Return the scheme of a source, such as `usb` or `rtsp`; empty for a file or folder."""
    found = SCHEME.match(source)
    return "" if found is None or OWN_FILE.fullmatch(source) else found[1]


def is_live(source: str) -> bool:
    """Return whether a source films now, in place of playing a recording."""
    return source.startswith((PHONE, SECRET)) or place_of(source) is None


def place_of(source: str) -> str | None:
    """Return the file or folder that a source names; None for a device or a stream.

    Raises:
        InputError: for a recording, a phone or a secret without a name.
    """
    if source == RECORDED:
        raise InputError("source", repr(source), "recorded:RECORDING, a recording's folder")
    if source == PHONE:
        raise InputError("source", repr(source), "phone:FILE, as `e3pose phone FILE` makes it")
    if source == SECRET:
        raise InputError("source", repr(source), "secret:FILE, a private file with the address")
    for kind in (RECORDED, PHONE, SECRET):
        if source.startswith(kind):
            return source.removeprefix(kind)
    return None if scheme_of(source) or OWN_FILE.fullmatch(source) else source


def shown_source(source: str, folder: Path) -> str:
    """Return a source as a settings file in a folder has it, in at most 60 characters."""
    return masked(source.replace(f"{folder}/", "", 1))[:60]


def revealed(source: str) -> str:
    """Return the address that a private file or the environment holds; another source as it is.

    Raises:
        InputError: for a file that is missing or that others can read, for no such variable, and
            for what is no address.
    """
    if source.startswith(SECRET):
        address = read_secret(Path(source.removeprefix(SECRET)), "source")
    elif source.startswith(ENVIRONMENT):
        address = os.environ.get(source.removeprefix(ENVIRONMENT), "")
        if not address:
            raise InputError(source, MISSING, "the camera's address in this environment variable")
    else:
        return source
    if "://" not in address and not address.startswith("gstreamer:"):
        raise InputError("source", f"no address in {source}", "rtsp://USER:PASSWORD@HOST/PATH")
    return address


def put_away(source: str, folder: Path, name: str) -> str:
    """Move an address with a password to a private file of a site's folder.

    Args:
        source: of a camera.
        folder: of the site.
        name: of the camera.

    Returns:
        `secret:FILE`, relative to the folder; another source as it is.
    """
    if not has_secret(source):
        return source
    files = (folder / SECRETS / f"{name}{end}" for end in ("", *(f"-{i}" for i in range(2, 1000))))
    file = next(path for path in files if not path.exists())
    make_folder(file.parent)
    write_file(file, f"{source}\n", private=True)
    return f"{SECRET}{SECRETS}/{file.name}"


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
        return own_beside(source, near("."))
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
    if all(value is getattr(record, name) for name, value in found.items()):
        return record  # the default, where nobody wrote another
    return replace(record, **found)  # type: ignore[type-var]


def _placed(value: Any, folder: Path) -> Any:
    if isinstance(value, Path):
        return near(folder, value)
    if isinstance(value, tuple):
        return tuple(_placed(each, folder) for each in value)
    return placed(value, folder) if is_dataclass(value) else value
