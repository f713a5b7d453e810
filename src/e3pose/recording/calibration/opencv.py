"""Calibration files of OpenCV's FileStorage (YAML).

One camera a file, named by `camera_name` or else by the file; or one file with a `cameras` list of
such cameras; or a folder of files. `FIELDS` has the accepted names; the first that is there counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.recording.calibration import fields
from e3pose.recording.calibration.nodes import load_nodes

FIELDS: Mapping[str, tuple[str, ...]] = {
    "name": ("camera_name", "name"),
    "matrix": ("camera_matrix", "Camera_Matrix", "cameraMatrix", "intrinsics", "K"),
    "distortion": (
        "distortion_coefficients",
        "Distortion_Coefficients",
        "distCoeffs",
        "distortion",
        "dist",
        "D",
    ),
    "rotation": ("R", "rotation_matrix", "rotation", "rvec"),
    "translation": ("T", "t", "translation_vector", "translation", "tvec"),
    "width": ("image_width", "image_Width", "width"),
    "height": ("image_height", "image_Height", "height"),
    "fisheye": ("fisheye", "fisheye_model"),
    "units": ("units",),
}
FISHEYE_MODELS = ("fisheye", "equidistant", "kannala_brandt")
PINHOLE_MODELS = ("plumb_bob", "rational_polynomial", "pinhole", "none")


def load(path: Path) -> Rig:
    """Read OpenCV YAML: a file, or a folder with a file for each camera.

    Raises:
        InputError: for a field that is missing or wrong, or too many files.
    """
    files = [path]
    if path.is_dir():
        files = sorted(f for f in path.iterdir() if f.suffix.lower() in (".yml", ".yaml"))
        if not files or len(files) > fields.MAX_CAMERAS:
            raise InputError(
                f"{path}: found {len(files)} YAML files, expected 1 to {fields.MAX_CAMERAS}"
            )
    cameras, assumed = [], False
    for file in files:
        nodes = load_nodes(file)
        entries = nodes.get("cameras", [nodes])
        if not isinstance(entries, list):
            raise InputError(f"{file}: cameras: found something else, expected a list")
        common = {name: nodes[name] for name in FIELDS["units"] if name in nodes}
        for index, entry in enumerate(entries):
            where = f"{file}: camera number {index + 1}"
            camera = {**common, **fields.table(entry, where)}
            assumed |= "units" not in camera
            default = file.stem if entry is nodes else None
            cameras.append(_camera(file, where, camera, default))
    return fields.make_rig(path, cameras, "metres" if assumed else None)


def _camera(path: Path, where: str, nodes: Mapping[str, Any], default_name: str | None) -> Camera:
    def node(key: str) -> tuple[str, Any]:
        for name in FIELDS[key]:
            if name in nodes:
                return name, nodes[name]
        raise InputError(f"{where}: {key}: found none of {', '.join(FIELDS[key])}")

    def optional(key: str, default: Any) -> Any:
        return next((nodes[name] for name in FIELDS[key] if name in nodes), default)

    def numbers(key: str, *shapes: tuple[int, ...]) -> Floats:
        name, value = node(key)
        return fields.numbers(value, shapes, f"{where}: {name}")

    name = optional("name", default_name)
    if name is None:
        raise InputError(f"{where}: name: found none of {', '.join(FIELDS['name'])}")
    name = fields.name_of(name)
    where = f"{path}: camera {name[:80].encode('unicode_escape').decode()}"
    metres_per_unit = fields.units_of(optional("units", "m"), where)
    return fields.make_camera(
        path,
        name,
        (float(numbers("width", ())), float(numbers("height", ()))),
        numbers("matrix", (3, 3)),
        numbers("rotation", (3, 3), (3,)),
        numbers("translation", (3,)) * metres_per_unit,
        numbers("distortion"),
        _fisheye(where, nodes, optional("fisheye", "0")),
    )


def _fisheye(where: str, nodes: Mapping[str, Any], flag: object) -> bool:
    model = nodes.get("distortion_model", "")
    if model in FISHEYE_MODELS:
        return True
    if model != "" and model not in PINHOLE_MODELS:
        raise InputError(
            f"{where}: distortion_model: found {fields.name_of(model)[:60]!r}, "
            f"expected one of {', '.join((*PINHOLE_MODELS, *FISHEYE_MODELS))}"
        )
    if str(flag).lower() not in ("0", "1", "true", "false"):
        raise InputError(f"{where}: fisheye: found {str(flag)[:40]!r}, expected 0 or 1")
    return str(flag).lower() in ("1", "true")
