"""Calibration files: rigs read from the formats in use, and written in aniposelib's."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from e3pose.base.bounded import parse_toml
from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.recording.calibration import (
    anipose,
    caliscope,
    easymocap,
    fields,
    nodes,
    opencv,
    qualisys,
)

FORMATS: dict[str, Callable[[Path, list[str]], Rig]] = {
    "anipose": anipose.load,
    "pose2sim": anipose.load,
    "caliscope": caliscope.load,
    "qualisys": qualisys.load,
    "easymocap": easymocap.load,
    "panoptic": opencv.load_panoptic,
    "opencv": opencv.load,
}
TOML_FORMATS = (None, "anipose", "pose2sim", "caliscope")
JSON = re.compile(r"\s*(\{|\[\s*\{)")  # how it begins
TOML = re.compile(r"\[|(?![<{])[^:=]+=")  # how its first line begins


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """The content of a calibration file.

    Attributes:
        rig: the cameras.
        rotations: 90, 180 or 270 for each camera that is turned: by how many degrees clockwise its
            images are turned for people in them to be upright. Only Caliscope's files say so.
        format: the key of `FORMATS` that it is in.
        notes: what a user should know of how it was read.
    """

    rig: Rig
    rotations: Mapping[str, int]
    format: str
    notes: tuple[str, ...] = ()


def load_rig(path: Path, format: str | None = None) -> Rig:
    """Read the cameras of a calibration; see `load_calibration`."""
    return load_calibration(path, format).rig


def load_calibration(path: Path, format: str | None = None) -> Calibration:
    """Read all that a calibration says.

    Args:
        path: a file, or the folder of an EasyMocap or OpenCV calibration.
        format: a key of `FORMATS`; None recognises the format by the content.

    Returns:
        The rig in metres, cameras in the order of the file. All formats but Panoptic's keep the
        file's world axes, which should have z up.

    Raises:
        InputError: naming the file, camera and field that is wrong.
    """
    if format is not None and format not in FORMATS:
        raise InputError(
            f"calibration format {format[:40]!r} is unknown, expected one of {', '.join(FORMATS)}"
        )
    path = Path(path)
    text = "" if path.is_dir() else fields.read_text(path)
    lines = (line.strip() for line in text.splitlines())
    first = next((line for line in lines if line and not line.startswith("#")), "")
    is_toml = format in TOML_FORMATS and TOML.match(first) and not JSON.match(text)
    tables = parse_toml(text, str(path)) if is_toml else {}
    if format is None:
        format = _of_folder(path) if path.is_dir() else _of_text(path, text, first, tables)
    turned = caliscope.rotations(path, tables) if format == "caliscope" else {}
    notes: list[str] = []
    return Calibration(FORMATS[format](path, notes), turned, format, tuple(notes))


def save_rig(rig: Rig, path: Path) -> None:
    """Write a rig as aniposelib TOML in metres; the file appears whole or not at all."""
    anipose.save(rig, Path(path))


def _of_folder(path: Path) -> str:
    """Return the format of a folder, by the names of its files."""
    if (path / "intri.yml").is_file() or (path / "extri.yml").is_file():
        return "easymocap"
    if any(file.suffix.lower() in (".yml", ".yaml") for file in path.iterdir()):
        return "opencv"
    raise InputError(
        f"{path}: found a folder without YAML files, expected a calibration file, or the "
        "folder of intri.yml and extri.yml"
    )


def _of_text(path: Path, text: str, first: str, tables: Mapping[str, Any]) -> str:
    """Return the format of a file: of its text, first line, and tables if it is TOML."""
    if first.startswith("<"):
        return "qualisys"
    if JSON.match(text):
        return "panoptic" if '"distCoef"' in text and '"cameras"' in text else "opencv"
    if TOML.match(first):
        return "caliscope" if caliscope.looks_like(tables) else "anipose"
    if first.startswith(("%YAML", "---")) or re.match(r"[^:]+:", first):
        named = nodes.parse(path, text)
        pair = path.name in ("intri.yml", "extri.yml") or "names" in named
        return "easymocap" if pair else "opencv"
    raise InputError(
        f"{path}: found no calibration that is known, expected one of {', '.join(FORMATS)}"
    )
