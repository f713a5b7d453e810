"""Calibration files of Caliscope: tables `[cameras.N]` or, in older projects, `[cam_N]`.

The fields are aniposelib's, with `port` for a name, `ignore`, and `rotation_count`: by how many
quarter turns Caliscope turns the images before it looks for people. The matrix belongs to the
images as they were before that, so a turned camera is refused rather than guessed at.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from e3pose.errors import InputError
from e3pose.geometry.camera import Rig
from e3pose.recording.calibration import anipose, fields


def load(path: Path) -> Rig:
    """Read Caliscope's TOML."""
    return read(path, anipose.parse(path, fields.read_text(path)))


def looks_like(tables: Mapping[str, Any]) -> bool:
    """Tell Caliscope's tables from aniposelib's."""
    return any(
        "rotation_count" in entry or "port" in entry or "cam_id" in entry
        for entry in _entries(tables).values()
        if isinstance(entry, Mapping)
    )


def read(path: Path, tables: Mapping[str, Any]) -> Rig:
    """Make a rig of Caliscope's tables, without the cameras that are marked `ignore`.

    Raises:
        InputError: for a field that is missing or wrong, or a rotated camera.
    """
    metadata = fields.table(tables.get("metadata", {}), f"{path}: metadata")
    metres_per_unit = 1.0
    if "units" in metadata:
        metres_per_unit = fields.units_of(metadata["units"], f"{path}: metadata")
    cameras = []
    for section, entry in _entries(tables).items():
        shown = section[:80].encode("unicode_escape").decode()
        where = f"{path}: camera {shown}"
        camera = fields.table(entry, where)
        if camera.get("ignore", False) is True:
            continue
        rotations = camera.get("rotation_count", 0)
        if rotations != 0:
            raise InputError(
                f"{where}: rotation_count: found {rotations!r:.40}, expected 0; turn the video "
                "upright and calibrate that"
            )
        number = camera.get("cam_id", camera.get("port", section.removeprefix("cam_")))
        name = fields.name_of(camera.get("name", f"cam_{fields.name_of(number)}"))
        cameras.append(anipose.read_camera(path, shown, name, camera, metres_per_unit))
    return fields.make_rig(path, cameras, None if "units" in metadata else "metres")


def _entries(tables: Mapping[str, Any]) -> Mapping[str, Any]:
    nested = tables.get("cameras")
    if isinstance(nested, Mapping):
        return nested
    return {name: entry for name, entry in tables.items() if name.startswith("cam_")}
