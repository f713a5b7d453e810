"""Calibration files of EasyMocap: `intri.yml` and `extri.yml` in one folder, metres.

`names` lists the cameras; `K_<name>` and `dist_<name>` are in the first file, `R_<name>` (Rodrigues
vector) or `Rot_<name>` (matrix) and `T_<name>` in the second. `H_<name>` and `W_<name>` give the
image size; without them it is taken from the principal point, see `guess_size`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.recording.calibration import fields
from e3pose.recording.calibration.nodes import load_nodes

USUAL_SIZES = (
    (360, 288), (640, 480), (800, 600), (1024, 768), (1032, 776), (1280, 720), (1280, 960),
    (1280, 1024), (1440, 1080), (1920, 1080), (1920, 1200), (2048, 2048), (2560, 1440),
    (2704, 1520), (3840, 2160),
)  # fmt: skip
SIZE_TOLERANCE = 0.05  # of a side: how far a principal point may lie from twice the middle


def load(path: Path, notes: list[str]) -> Rig:
    """Read EasyMocap's pair of files, given either of them or their folder.

    Raises:
        InputError: for a file that is missing, or a field that is missing or wrong.
    """
    folder = path if path.is_dir() else path.parent
    intrinsics_path, extrinsics_path = folder / "intri.yml", folder / "extri.yml"
    intrinsics, extrinsics = load_nodes(intrinsics_path), load_nodes(extrinsics_path)
    names = fields.field(intrinsics, "names", f"{intrinsics_path}")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError(f"{intrinsics_path}: names: found something else, expected a list")
    if len(names) > fields.MAX_CAMERAS:
        raise InputError(f"{intrinsics_path}: names: found {len(names)} cameras")
    cameras = [
        _camera((intrinsics_path, intrinsics), (extrinsics_path, extrinsics), name, notes)
        for name in names
    ]
    return fields.make_rig(folder, cameras, "metres", notes)


def _camera(
    intrinsics: tuple[Path, Mapping[str, Any]],
    extrinsics: tuple[Path, Mapping[str, Any]],
    name: str,
    notes: list[str],
) -> Camera:
    shown = name[:80].encode("unicode_escape").decode()

    def numbers(file: tuple[Path, Mapping[str, Any]], key: str, *shapes: tuple[int, ...]) -> Floats:
        where = f"{file[0]}: camera {shown}"
        node = fields.field(file[1], f"{key}_{name}", where)
        return fields.numbers(node, shapes, f"{where}: {key}_{shown}")

    K = numbers(intrinsics, "K", (3, 3))
    if f"H_{name}" in intrinsics[1] or f"W_{name}" in intrinsics[1]:
        size = (float(numbers(intrinsics, "W", ())), float(numbers(intrinsics, "H", ())))
    else:
        size = guess_size(float(K[0, 2]), float(K[1, 2]), shown, notes)
    if f"Rot_{name}" in extrinsics[1]:
        rotation = numbers(extrinsics, "Rot", (3, 3))
    else:
        rotation = numbers(extrinsics, "R", (3,), (3, 3))
    return fields.make_camera(
        intrinsics[0].parent,
        name,
        size,
        K,
        rotation,
        numbers(extrinsics, "T", (3,)),
        numbers(intrinsics, "dist"),
    )


def guess_size(
    center_u: float, center_v: float, name: str, notes: list[str]
) -> tuple[float, float]:
    """Return the usual image size with its middle near the principal point, else twice that.

    Args:
        center_u: x of the principal point, pixels.
        center_v: its y.
        name: of the camera.
        notes: take that the size is a guess.
    """
    wanted = np.array([2 * center_u, 2 * center_v])
    sizes = np.array([*USUAL_SIZES, *((h, w) for w, h in USUAL_SIZES)], dtype=np.float64)
    off = (np.abs(wanted - sizes) / sizes).max(axis=1)
    nearest = sizes[off.argmin()] if off.min() <= SIZE_TOLERANCE else wanted.round()
    width, height = nearest.tolist()
    notes.append(
        f"camera {name}: the file says no image size, taken for {width:g} x {height:g} by its "
        "principal point"
    )
    return width, height
