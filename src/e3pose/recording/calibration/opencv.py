"""Calibration files of named fields: OpenCV's YAML, JSON, Kalibr, multical, VoxelPose.

One camera a file, named by `camera_name` or else by the file; or one file with a `cameras` list or
table of such cameras, or a list of them alone; or a folder of files. Kalibr's chain places each
camera against the one before it. `FIELDS` has the accepted names; the first that is there counts.
A camera of JSON with neither rotation nor translation is kept unplaced.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.recording.calibration import easymocap, fields
from e3pose.recording.calibration.nodes import parse, parse_json

FIELDS: Mapping[str, tuple[str, ...]] = {
    "name": ("camera_name", "name", "camera_id", "cam_id", "id"),
    "matrix": (
        "camera_matrix", "Camera_Matrix", "cameraMatrix", "intrinsics", "K", "matrix", "mtx",
    ),
    "distortion": (
        "distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "distortion", "dist",
        "D", "DC", "distCoef", "distortions", "distortion_coeffs",
    ),
    "rotation": ("R", "rotation_matrix", "rotation", "rvec"),
    "translation": ("T", "t", "translation_vector", "translation", "tvec"),
    "width": ("image_width", "image_Width", "width"),
    "height": ("image_height", "image_Height", "height"),
    "size": ("image_size", "resolution", "size", "img_size"),
    "fisheye": ("fisheye", "fisheye_model"),
    "units": ("units",),
}  # fmt: skip
PARTS = {"fx", "extrinsics"}.union(
    *(FIELDS[key] for key in ("matrix", "distortion", "rotation", "translation"))
)
VOXELPOSE = {"R", "T", "fx", "fy", "cx", "cy", "k", "p"}  # T is a centre, in millimetres
# From Panoptic's world axes to z up: x stays, z becomes y, down becomes minus z.
WORLD_FROM_PANOPTIC = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
FISHEYE_MODELS = ("fisheye", "equidistant", "kannala_brandt")
PINHOLE_MODELS = ("plumb_bob", "rational_polynomial", "pinhole", "none", "radtan", "standard")


def load_panoptic(path: Path, notes: list[str]) -> Rig:
    """Read a calibration of CMU's Panoptic Studio: centimetres, y down."""
    rig = load(path, notes, "cm")
    return replace(
        rig,
        cameras=tuple(
            replace(camera, T_world_camera=WORLD_FROM_PANOPTIC @ camera.T_world_camera)
            for camera in rig.cameras
        ),
    )


def load(path: Path, notes: list[str], unit: str = "m") -> Rig:
    """Read OpenCV YAML or JSON: a file, or a folder with a file for each camera.

    Args:
        path: of it.
        notes: take what a user should know.
        unit: of lengths, where the file does not say.

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
    cameras, unplaced, assumed = list[Camera](), list[int](), False
    for file in files:
        text = fields.read_text(file)
        is_json = text.lstrip()[:1] in "[{"  # and so not cut short
        nodes = parse_json(file, text) if is_json else parse(file, text)
        common, entries = _entries(file, nodes, notes)
        for index, (default, entry) in enumerate(entries):
            where = f"{file}: camera number {index + 1}"
            given = fields.table(entry, where)
            camera = {**common, **{key: v for key, v in given.items() if v is not None}}
            camera |= _in_parts(where, camera)
            assumed |= "units" not in camera
            if is_json and not {*FIELDS["rotation"], *FIELDS["translation"]} & camera.keys():
                unplaced.append(len(cameras))
                camera |= {"R": np.eye(3).tolist(), "T": [0.0] * 3}
            cameras.append(_camera(file, where, {"units": unit, **camera}, default, notes))
    taken_for = {"m": "metres", "cm": "centimetres"}[unit] if assumed else None
    return fields.make_rig(path, cameras, taken_for, notes, unplaced)


def _entries(
    file: Path, nodes: Any, notes: list[str]
) -> tuple[dict[str, Any], list[tuple[str | None, Any]]]:
    """Return the entries shared by a file's cameras, and each camera's with its name, if a key."""
    if isinstance(nodes, list):
        return {}, [(None, entry) for entry in nodes]
    common = {name: nodes[name] for name in FIELDS["units"] if name in nodes}
    poses = nodes.get("camera_poses")  # of multical
    if isinstance(poses, Mapping) and isinstance(nodes.get("cameras"), Mapping):
        known = {name.split("_to_")[0]: pose for name, pose in poses.items()}
        return common, [
            (name, {**fields.table(entry, f"{file}: camera {name[:80]}"),
                    **fields.table(known.get(name, {}), f"{file}: pose of camera {name[:80]}")})
            for name, entry in nodes["cameras"].items()
        ]  # fmt: skip
    cameras = nodes.get("cameras", nodes)
    if isinstance(cameras, list):
        return common, [(None, entry) for entry in cameras]
    if not isinstance(cameras, Mapping):
        raise InputError(f"{file}: cameras: found something else, expected a list")
    if "cam0" in cameras and "intrinsics" in fields.table(cameras["cam0"], f"{file}: cam0"):
        return common, [*_kalibr(file, cameras)]
    if cameras is nodes:  # beside cameras there may be tables of others
        cameras = {n: e for n, e in nodes.items() if isinstance(e, Mapping) and {*e} & PARTS}
        if not cameras or {*nodes} & PARTS - cameras.keys():
            return common, [(file.stem, nodes)]
        named = {name.rstrip("0123456789") for name in cameras}
        for name in nodes.keys() - cameras.keys():
            if name.rstrip("0123456789") in named:
                notes.append(f"{file}: {name[:80]}: left out, it has no field of a camera")
    if any(isinstance(e, Mapping) and {*e} >= VOXELPOSE for e in cameras.values()):
        return common, [(name, _voxelpose(file, name, e, notes)) for name, e in cameras.items()]
    return common, list(cameras.items())


def _kalibr(file: Path, nodes: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the cameras of Kalibr's chain, each placed against the one before."""
    T_camera_world = np.eye(4)  # the world is the first camera's
    count = sum(re.fullmatch("cam[0-9]+", name) is not None for name in nodes)
    for name in (f"cam{index}" for index in range(count)):
        where = f"{file}: camera {name}"
        camera = fields.table(fields.field(nodes, name, str(file)), where)
        if name != "cam0":
            link = fields.field(camera, "T_cn_cnm1", where)
            T_camera_world = fields.numbers(link, [(4, 4)], f"{where}: T_cn_cnm1") @ T_camera_world
        fx, fy, cx, cy = fields.numbers(
            fields.field(camera, "intrinsics", where), [(4,)], f"{where}: intrinsics"
        ).tolist()
        yield (
            name,
            {
                **{key: value for key, value in camera.items() if key != "intrinsics"},
                "K": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]],
                "R": T_camera_world[:3, :3].tolist(),
                "T": T_camera_world[:3, 3].tolist(),
            },
        )


def _in_parts(where: str, camera: Mapping[str, Any]) -> dict[str, Any]:
    """Return the matrix and place of a camera that has them as fx, fy, cx, cy and as 4 x 4."""
    found: dict[str, Any] = {}
    lens = next((v for v in camera.values() if isinstance(v, Mapping) and "fx" in v), camera)
    if {"fx", "fy", "cx", "cy"} <= {*lens}:
        found["camera_matrix"] = [
            [lens["fx"], 0, lens["cx"]], [0, lens["fy"], lens["cy"]], [0, 0, 1],
        ]  # fmt: skip
    if "extrinsics" in camera and not isinstance(camera["extrinsics"], Mapping):
        shapes = [(4, 4), (3, 4)]
        place = fields.numbers(camera["extrinsics"], shapes, f"{where}: extrinsics")
        found |= {"R": place[:3, :3].tolist(), "T": place[:3, 3].tolist()}
    return found


def _voxelpose(file: Path, name: str, camera: object, notes: list[str]) -> dict[str, Any]:
    """Return the fields of a camera of VoxelPose, which has no image size."""
    where = f"{file}: camera {name[:80]}"
    given = fields.table(camera, where)

    def numbers(key: str, *shape: int) -> Floats:
        return fields.numbers(fields.field(given, key, where), [shape], f"{where}: {key}")

    k, p, R = numbers("k", 3), numbers("p", 2), numbers("R", 3, 3)
    size = given.get("size")
    if size is None:
        size = easymocap.guess_size(float(numbers("cx")), float(numbers("cy")), name, notes)
    return {
        **{key: float(numbers(key)) for key in ("fx", "fy", "cx", "cy")},
        "dist": [*k[:2].tolist(), *p.tolist(), float(k[2])],
        "R": R.tolist(),
        "T": (-R @ numbers("T", 3) / 1000).tolist(),
        "size": size,
    }


def _camera(
    path: Path,
    where: str,
    nodes: Mapping[str, Any],
    default_name: str | None,
    notes: list[str],
) -> Camera:
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
    metres_per_unit = fields.units_of(optional("units", ""), where)
    size: Any = optional("size", None)
    if size is None:
        size = float(numbers("width", ())), float(numbers("height", ()))
    else:
        size = numbers("size", (2,))
    return fields.make_camera(
        path,
        name,
        size,
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
