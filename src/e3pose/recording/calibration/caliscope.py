"""Calibration files of Caliscope: tables `[cameras.N]` or, in older projects, `[cam_N]`.

The fields are aniposelib's, with `port` for a name, `ignore`, and `rotation_count`: by how many
quarter turns, clockwise if positive, Caliscope turns the images before it looks for people. The
matrix belongs to the images as they were before that.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.model.camera_fields import safe_id
from e3pose.recording.calibration import anipose, fields

QUARTERS = 4


def load(path: Path, notes: list[str]) -> Rig:
    """Read Caliscope's TOML."""
    return read(path, anipose.parse(path, fields.read_text(path)), notes)


def looks_like(tables: Mapping[str, Any]) -> bool:
    """Tell Caliscope's tables from aniposelib's."""
    return any(
        "rotation_count" in entry or "port" in entry or "cam_id" in entry
        for entry in _entries(tables).values()
        if isinstance(entry, Mapping)
    )


def read(path: Path, tables: Mapping[str, Any], notes: list[str]) -> Rig:
    """Make a rig of Caliscope's tables, without the cameras that are marked `ignore`.

    Raises:
        InputError: for a field that is missing or wrong.
    """
    entries = [*_cameras(path, tables)]
    for shown, _, camera in entries:
        _degrees(camera, f"{path}: camera {shown}")
    return anipose.read_cameras(path, entries, tables.get("metadata", {}), notes)


def rotations(path: Path, tables: Mapping[str, Any]) -> dict[str, int]:
    """Return by how many degrees clockwise images are turned for people to be upright.

    Args:
        path: for messages.
        tables: of the file.

    Returns:
        90, 180 or 270 for each camera that is turned.

    Raises:
        InputError: for a field that is wrong.
    """
    found = {
        safe_id(name): _degrees(camera, f"{path}: camera {shown}")
        for shown, name, camera in _cameras(path, tables)
    }
    return {name: degrees for name, degrees in found.items() if degrees}


def _degrees(camera: Mapping[str, Any], where: str) -> int:
    """Return 0, 90, 180 or 270 degrees clockwise."""
    count = camera.get("rotation_count", 0)
    if isinstance(count, bool) or not isinstance(count, int) or abs(count) >= QUARTERS:
        raise InputError(
            f"{where}: rotation_count: found {count!r:.40}, expected quarter turns from -3 to 3"
        )
    return count % QUARTERS * 90


def _cameras(path: Path, tables: Mapping[str, Any]) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    """Yield section, name and table of each camera that is not marked `ignore`."""
    for section, entry in _entries(tables).items():
        shown = section[:80].encode("unicode_escape").decode()
        camera = fields.table(entry, f"{path}: camera {shown}")
        if camera.get("ignore", False) is True:
            continue
        number = camera.get("cam_id", camera.get("port", section.removeprefix("cam_")))
        yield shown, fields.name_of(camera.get("name", f"cam_{fields.name_of(number)}")), camera


def _entries(tables: Mapping[str, Any]) -> Mapping[str, Any]:
    nested = tables.get("cameras")
    if isinstance(nested, Mapping):
        return nested
    return {name: entry for name, entry in tables.items() if name.startswith("cam_")}
