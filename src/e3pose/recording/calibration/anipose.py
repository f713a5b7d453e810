"""Calibration files of aniposelib, e3pose's own format too, and of Pose2Sim.

One table a camera with `name`, `size`, `matrix`, `distortions`, `rotation` (Rodrigues vector),
`translation` (world to camera) and optional `fisheye`, `title` and `placed`. aniposelib states no
units: metres are assumed unless `units` under `[metadata]` says otherwise.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from e3pose.base.arrays import Floats
from e3pose.base.atomic import write_file
from e3pose.base.bounded import parse_toml
from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.recording.calibration import fields

CAMERA = {"matrix", "size", "distortions", "rotation", "translation", "name"}
NOWHERE = {"rotation": [0.0] * 3, "translation": [0.0] * 3}  # of a camera without a place


def load(path: Path, notes: list[str]) -> Rig:
    """Read aniposelib's or Pose2Sim's TOML."""
    return read(path, parse(path, fields.read_text(path)), notes)


def parse(path: Path, text: str) -> dict[str, Any]:
    """Return the tables of a TOML file."""
    return parse_toml(text, str(path))


def read(path: Path, tables: Mapping[str, Any], notes: list[str]) -> Rig:
    """Make a rig of aniposelib's tables, in the order of the file."""
    kind = tables.get("format")
    if isinstance(kind, str):
        found = f"a file of the format {kind[:40]!r}"
        raise InputError(str(path), found, "a calibration file, such as rig.toml")
    entries = []
    for section, entry in tables.items():
        if section == "metadata" or (isinstance(entry, Mapping) and not CAMERA & {*entry}):
            continue  # of another tool
        shown = section[:80].encode("unicode_escape").decode()
        camera = fields.table(entry, f"{path}: camera {shown}")
        entries.append((shown, fields.name_of(camera.get("name", section)), camera))
    return read_cameras(path, entries, tables.get("metadata", {}), notes)


def read_cameras(
    path: Path,
    entries: Iterable[tuple[str, str, Mapping[str, Any]]],
    metadata: object,
    notes: list[str],
) -> Rig:
    """Make a rig of tables; a camera without rotation and translation is kept unplaced.

    Args:
        path: for messages.
        entries: section for messages, name and table of each camera.
        metadata: the table of that name.
        notes: take what a user should know.
    """
    metadata = fields.table(metadata, f"{path}: metadata")
    metres_per_unit = 1.0
    if "units" in metadata:
        metres_per_unit = fields.units_of(metadata["units"], f"{path}: metadata")
    cameras, unplaced = [], []
    for shown, name, table in entries:
        given = _flag(table, "placed", bool(NOWHERE.keys() & table), f"{path}: camera {shown}")
        camera = table if given else {**NOWHERE, **table}
        cameras.append(_read_camera(path, shown, name, camera, metres_per_unit, notes))
        unplaced += [] if given else [len(cameras) - 1]
    placed = _flag(metadata, "placed", True, f"{path}: metadata")
    assumed_units = None if "units" in metadata or not placed else "metres"
    rig = fields.make_rig(path, cameras, assumed_units, notes, unplaced)
    return rig if placed else replace(rig, placed=False, unplaced=())


def _read_camera(
    path: Path,
    section: str,
    name: str,
    camera: Mapping[str, Any],
    metres_per_unit: float,
    notes: list[str],
) -> Camera:
    where = f"{path}: camera {section}"

    def numbers(key: str, *shapes: tuple[int, ...]) -> Floats:
        return fields.numbers(fields.field(camera, key, where), shapes, f"{where}: {key}")

    made = fields.make_camera(
        path,
        name,
        numbers("size", (2,)),
        numbers("matrix", (3, 3)),
        numbers("rotation", (3,), (3, 3)),
        numbers("translation", (3,)) * metres_per_unit,
        numbers("distortions"),
        _flag(camera, "fisheye", False, where),
        fields.shown_title(fields.name_of(camera.get("title", ""))),
    )
    known_to = None
    if "known_to_deg" in camera:
        known_to = np.radians(fields.scalar(camera["known_to_deg"], f"{where}: known_to_deg"))
    assumed = _flag(camera, "lens_assumed", False, where)
    return replace(made, lens_assumed=assumed, known_to=known_to)


def _flag(table: Mapping[str, Any], key: str, default: bool, where: str) -> bool:
    value = table.get(key, default)
    if not isinstance(value, bool):
        raise InputError(f"{where}: {key}: found {value!r:.40}, expected true or false")
    return value


def save(rig: Rig, path: Path) -> None:
    """Write a rig; the file appears whole or not at all, and names its units."""
    tables: dict[str, Any] = {}
    for index, camera in enumerate(rig.cameras):
        tables[f"cam_{index}"] = {
            "name": camera.camera_id,
            **({"title": camera.title} if camera.title else {}),
            "size": list(camera.image_size),
            "matrix": camera.K.tolist(),
            "distortions": camera.distortion.tolist(),
            "rotation": fields.rotation_vector(camera.R).tolist(),
            "translation": camera.t.tolist(),
            "fisheye": camera.fisheye,
            **({"lens_assumed": True} if camera.lens_assumed else {}),
            **({"placed": False} if camera.camera_id in rig.unplaced else {}),
        }
        if camera.known_to is not None:
            tables[f"cam_{index}"]["known_to_deg"] = float(np.degrees(camera.known_to))
    tables["metadata"] = {"units": "m", "up": "z", **({} if rig.placed_ones else {"placed": False})}
    write_file(path, tomli_w.dumps(tables))
