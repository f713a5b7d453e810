"""Calibration files: rigs read from the formats in use, and written in aniposelib's."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.recording.calibration import (
    anipose,
    caliscope,
    easymocap,
    fields,
    nodes,
    opencv,
    panoptic,
    qualisys,
)

FORMATS: dict[str, Callable[[Path], Rig]] = {
    "anipose": anipose.load,
    "pose2sim": anipose.load,
    "caliscope": caliscope.load,
    "qualisys": qualisys.load,
    "easymocap": easymocap.load,
    "panoptic": panoptic.load,
    "opencv": opencv.load,
}


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What a calibration says.

    Attributes:
        rig: the cameras.
        rotations: 90, 180 or 270 for each camera that is turned: by how many degrees clockwise its
            images are turned for people in them to be upright. Only Caliscope's files say so.
    """

    rig: Rig
    rotations: Mapping[str, int] = field(default_factory=dict)


def load_calibration(path: Path) -> Calibration:
    """Read all that a calibration says; see `load_rig`."""
    path = Path(path)
    format = find_format(path)
    turned = caliscope.rotations(path) if format == "caliscope" else {}
    return Calibration(FORMATS[format](path), turned)


def load_rig(path: Path, format: str | None = None) -> Rig:
    """Read a calibration.

    Args:
        path: a file, or the folder of an EasyMocap or OpenCV calibration.
        format: a key of `FORMATS`; None recognises the format by the content.

    Returns:
        The rig in metres, cameras in the order of the file. All formats but Panoptic's keep the
        file's world axes, which should have z up.

    Raises:
        InputError: naming the file, camera and field that is wrong.
    """
    path = Path(path)
    if format is None:
        format = find_format(path)
    if format not in FORMATS:
        raise InputError(
            f"calibration format {format[:40]!r} is unknown, expected one of {', '.join(FORMATS)}"
        )
    return FORMATS[format](path)


def load_rotations(path: Path) -> dict[str, int]:
    """Return by how many degrees clockwise images are turned for people in them to be upright.

    Args:
        path: a calibration; only Caliscope's say so.

    Returns:
        90, 180 or 270 for each camera that is turned; the calibration is of unturned images.

    Raises:
        InputError: naming the file, camera and field that is wrong.
    """
    path = Path(path)
    return caliscope.rotations(path) if find_format(path) == "caliscope" else {}


def save_rig(rig: Rig, path: Path) -> None:
    """Write a rig as aniposelib TOML in metres; the file appears whole or not at all."""
    anipose.save(rig, Path(path))


def find_format(path: Path) -> str:
    """Return which of `FORMATS` a file or folder has, judged by its content.

    Raises:
        InputError: for a file or folder of no known format.
    """
    if path.is_dir():
        if (path / "intri.yml").is_file() or (path / "extri.yml").is_file():
            return "easymocap"
        if any(file.suffix.lower() in (".yml", ".yaml") for file in path.iterdir()):
            return "opencv"
        raise InputError(
            f"{path}: found a folder without YAML files, expected a calibration file, or the "
            "folder of intri.yml and extri.yml"
        )
    text = fields.read_text(path)
    lines = (line.strip() for line in text.splitlines())
    first = next((line for line in lines if line and not line.startswith("#")), "")
    if first.startswith("<"):
        return "qualisys"
    if first.startswith("{"):
        return "panoptic"
    if re.match(r"\[|[^:=]+=", first):
        tables = anipose.parse(path, text)
        return "caliscope" if caliscope.looks_like(tables) else "anipose"
    if first.startswith(("%YAML", "---")) or re.match(r"[^:]+:", first):
        named = nodes.parse(path, text)
        pair = path.name in ("intri.yml", "extri.yml") or "names" in named
        return "easymocap" if pair else "opencv"
    raise InputError(
        f"{path}: found no calibration that is known, expected one of {', '.join(FORMATS)}"
    )
