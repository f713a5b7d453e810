"""Calibration files of CMU's Panoptic Studio (JSON): centimetres, y down."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.recording.calibration import fields

METRES_PER_UNIT = 0.01
# From Panoptic's world axes to z up: x stays, z becomes y, down becomes minus z.
WORLD_FROM_PANOPTIC = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def load(path: Path, notes: list[str]) -> Rig:
    """Read a Panoptic calibration, all its cameras.

    Raises:
        InputError: for a field that is missing or wrong, or too many cameras.
    """
    document = fields.table(parse(path, fields.read_text(path)), f"{path}")
    entries = fields.field(document, "cameras", f"{path}")
    if not isinstance(entries, list):
        raise InputError(f"{path}: cameras: found something else, expected a list")
    if len(entries) > fields.MAX_CAMERAS:
        raise InputError(f"{path}: found {len(entries)} cameras")
    cameras = [_camera(path, index, entry, notes) for index, entry in enumerate(entries)]
    return fields.make_rig(path, cameras, "centimetres", notes)


def _camera(path: Path, index: int, entry: object, notes: list[str]) -> Camera:
    camera = fields.table(entry, f"{path}: camera number {index + 1}")
    name = fields.name_of(fields.field(camera, "name", f"{path}: camera number {index + 1}"))
    where = f"{path}: camera {name[:80].encode('unicode_escape').decode()}"

    def numbers(key: str, *shapes: tuple[int, ...]) -> Floats:
        return fields.numbers(fields.field(camera, key, where), shapes, f"{where}: {key}")

    with np.errstate(all="ignore"):
        rotation = numbers("R", (3, 3)) @ WORLD_FROM_PANOPTIC.T
    return fields.make_camera(
        path,
        name,
        numbers("resolution", (2,)),
        numbers("K", (3, 3)),
        rotation,
        numbers("t", (3,)) * METRES_PER_UNIT,
        numbers("distCoef"),
    )


def parse(path: Path, text: str) -> Any:
    """Return what the JSON of a calibration holds; raise `InputError` if it is none."""

    def unique(pairs: list[tuple[str, Any]]) -> Mapping[str, Any]:
        named = dict(pairs)
        if len(named) < len(pairs):
            raise InputError(f"{path}: found a field that is given twice")
        return named

    try:
        return json.loads(text, object_pairs_hook=unique)
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: found text that is not JSON: {str(error)[:120]}") from None
