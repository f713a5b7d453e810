"""Calibration files of every format, written here by hand in each format's own conventions."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]

NAN = float("nan")


@dataclass(frozen=True)
class Known:
    """A camera in textbook form, metres and z up; None leaves a field out of the file."""

    name: str
    size: tuple[float, float] | None
    K: Any
    R: Any  # world to camera
    t: Any
    distortion: Any
    extra: dict[str, Any] = field(default_factory=dict)


def looking_at_origin(name: str, center: tuple[float, float, float], focal: float) -> Known:
    forward = np.array([0.0, 0.0, 1.0]) - center
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    K = np.array([[focal, 0.0, 941.5], [0.0, focal * 1.01, 553.25], [0.0, 0.0, 1.0]])
    distortion = np.array([-0.21, 0.08, 0.0011, -0.0007, 0.013])
    return Known(name, (1920, 1080), K, R, -R @ np.array(center), distortion)


KNOWN = (
    looking_at_origin("hall_1", (4.0, 0.5, 2.2), 1180.0),
    looking_at_origin("hall_2", (-1.0, 5.0, 1.4), 1250.5),
    looking_at_origin("03", (-3.0, -3.5, 3.1), 990.25),
)
POINTS_M = np.random.default_rng(5).uniform((-1, -1, 0), (1, 1, 1.9), (40, 3))


def textbook_pixels(camera: Known, point_m: Floats) -> tuple[float, float]:
    """Project one point, written out and independent of the package."""
    x, y, z = (float(v) for v in camera.R @ point_m + camera.t)
    x, y = x / z, y / z
    k1, k2, p1, p2, k3 = (float(v) for v in camera.distortion)
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    K = camera.K
    return float(K[0, 0] * u + K[0, 2]), float(K[1, 1] * v + K[1, 2])


def _numbers(values: Any) -> str:
    """Write numbers, row by row if a matrix, in a way that JSON, TOML and YAML share."""
    if np.ndim(values) == 0:
        return repr(float(values))
    return "[" + ", ".join(_numbers(v) for v in values) + "]"


def _rodrigues(R: Any) -> Floats:
    if np.shape(R) != (3, 3) or not np.isfinite(R).all() or np.linalg.det(R) < 0.9:
        return np.full(3, NAN)
    return np.asarray(Rotation.from_matrix(R).as_rotvec())


def _toml_fields(camera: Known) -> list[str]:
    rows = {
        "size": camera.size,
        "matrix": camera.K,
        "distortions": camera.distortion,
        "rotation": None if camera.R is None else _rodrigues(camera.R),
        "translation": camera.t,
    }
    lines = [f"{key} = {_numbers(value)}" for key, value in rows.items() if value is not None]
    return lines + [f"{key} = {json.dumps(value)}" for key, value in camera.extra.items()]


def write_anipose(folder: Path, cameras: tuple[Known, ...]) -> Path:
    lines = _tables(cameras, "cam_{index}")
    return _write(folder / "calibration.toml", [*lines, "[metadata]", "adjusted = false"])


def write_pose2sim(folder: Path, cameras: tuple[Known, ...]) -> Path:
    lines = _tables(cameras, "{name}", "fisheye = false")
    lines += ["[metadata]", "adjusted = false", "error = 0.0"]
    return _write(folder / "Calib_qualisys.toml", lines)


def write_caliscope(folder: Path, cameras: tuple[Known, ...]) -> Path:
    turned = [replace(c, extra={"rotation_count": 0, **c.extra}) for c in cameras]
    lines = _tables(turned, "cameras.{index}", "port = {index}", 'exposure = "null"')
    return _write(folder / "camera_array.toml", lines)


def _tables(cameras: Sequence[Known], heading: str, *more: str) -> list[str]:
    """Return a table of TOML for each camera; {index} and {name} stand for those of the camera."""
    lines = []
    for index, camera in enumerate(cameras):
        name = json.dumps(camera.name)
        own = [line.format(index=index, name=name) for line in (f"[{heading}]", *more)]
        lines += [own[0], f"name = {name}", *own[1:], *_toml_fields(camera), ""]
    return lines


def write_qualisys(folder: Path, cameras: tuple[Known, ...]) -> Path:
    """Millimetres, 64ths of pixels, a field of view that starts at (16, 8), y up and -z ahead."""
    lines = ["<?xml version='1.0' encoding='ASCII'?>", "<calibration>", "<cameras>"]
    for camera in cameras:
        attributes = {"active": "1", "model": "Miqus Video", "viewrotation": "0", **camera.extra}
        shown = " ".join(f'{key}="{value}"' for key, value in attributes.items())
        lines.append(f'<camera serial="{camera.name}" {shown}>')
        if camera.size is not None:
            right, bottom = camera.size[0] + 15, camera.size[1] + 7
            lines.append(f'<fov_video left="16" top="8" right="{right}" bottom="{bottom}"/>')
        if camera.R is not None and camera.t is not None:
            x, y, z = (float(v) for v in -np.asarray(camera.R).T @ camera.t * 1000)
            axes = camera.R * np.array([[1.0], [-1.0], [-1.0]])
            rs = " ".join(
                f'r{i + 1}{j + 1}="{float(axes[i, j])!r}"' for i in range(3) for j in range(3)
            )
            lines.append(f'<transform x="{x!r}" y="{y!r}" z="{z!r}" {rs}/>')
        if camera.K is not None and camera.distortion is not None:
            k1, k2, p1, p2, k3 = (repr(float(v)) for v in camera.distortion)
            fu, fv = (repr(float(camera.K[i][i] * 64)) for i in (0, 1))
            cu, cv = (repr(float((camera.K[i][2] + (16, 8)[i]) * 64)) for i in (0, 1))
            lines.append(
                f'<intrinsic focalLengthU="{fu}" focalLengthV="{fv}" centerPointU="{cu}" '
                f'centerPointV="{cv}" radialDistortion1="{k1}" radialDistortion2="{k2}" '
                f'radialDistortion3="{k3}" tangentalDistortion1="{p1}" '
                f'tangentalDistortion2="{p2}"/>'
            )
        lines.append("</camera>")
    lines += ["</cameras>", "</calibration>"]
    return _write(folder / "Calib.qca.txt", lines)


def write_panoptic(folder: Path, cameras: tuple[Known, ...]) -> Path:
    """Centimetres and y down: the point (x, y, z) of a z-up world is (x, -z, y) there."""
    entries = []
    world_from_file = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    for camera in cameras:
        entry: dict[str, Any] = {"name": camera.name, "type": "hd", "panel": 0, "node": 1}
        if camera.size is not None:
            entry["resolution"] = [int(v) for v in camera.size]
        if camera.K is not None:
            entry["K"] = np.asarray(camera.K).tolist()
        if camera.distortion is not None:
            entry["distCoef"] = np.asarray(camera.distortion).tolist()
        if camera.R is not None:
            entry["R"] = (np.asarray(camera.R) @ world_from_file).tolist()
        if camera.t is not None:
            entry["t"] = [[float(v) * 100] for v in camera.t]
        entries.append(entry | camera.extra)
    text = json.dumps({"calibDataSource": "160906_calib_norm", "cameras": entries}, indent=1)
    return _write(folder / "calibration_160906_band1.json", text.split("\n"))


def _matrix(values: Any) -> str:
    array = np.asarray(values, dtype=float)
    array = array.reshape(-1, 1) if array.ndim == 1 else array
    data = ", ".join(repr(float(v)) for v in array.ravel())
    return (
        f"!!opencv-matrix\n   rows: {array.shape[0]}\n   cols: {array.shape[1]}\n   dt: d\n"
        f"   data: [ {data} ]"
    )


def write_easymocap(folder: Path, cameras: tuple[Known, ...]) -> Path:
    names = ["names:", *(f"   - {json.dumps(camera.name)}" for camera in cameras)]
    intrinsics, extrinsics = ["%YAML:1.0", "---", *names], ["%YAML:1.0", "---", *names]
    for camera in cameras:
        key = camera.name
        if camera.K is not None:
            intrinsics.append(f"K_{key}: {_matrix(camera.K)}")
        if camera.distortion is not None:
            intrinsics.append(f"dist_{key}: {_matrix([camera.distortion])}")
        if camera.size is not None:
            intrinsics += [f"W_{key}: {camera.size[0]}", f"H_{key}: {camera.size[1]}"]
        if camera.R is not None:
            extrinsics.append(f"Rot_{key}: {_matrix(camera.R)}")
            extrinsics.append(f"R_{key}: {_matrix(_rodrigues(camera.R))}")
        if camera.t is not None:
            extrinsics.append(f"T_{key}: {_matrix(camera.t)}")
    _write(folder / "extri.yml", extrinsics)
    return _write(folder / "intri.yml", intrinsics)


def write_opencv(folder: Path, cameras: tuple[Known, ...]) -> Path:
    lines = ["%YAML:1.0", "---", "cameras:"]
    for camera in cameras:
        entry = [f"camera_name: {json.dumps(camera.name)}"]
        if camera.size is not None:
            entry += [f"image_width: {camera.size[0]:g}", f"image_height: {camera.size[1]:g}"]
        for key, value in (
            ("camera_matrix", camera.K),
            ("distortion_coefficients", camera.distortion),
            ("R", camera.R),
            ("T", camera.t),
        ):
            if value is not None:
                entry.append(f"{key}: {_matrix(value)}")
        entry += [f"{key}: {value}" for key, value in camera.extra.items()]
        rows = "\n".join(entry).split("\n")
        lines += [f"   - {rows[0]}", *(f"     {row}" for row in rows[1:])]
    return _write(folder / "rig.yaml", lines)


def _write(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


Writer = Callable[[Path, tuple[Known, ...]], Path]
WRITERS: dict[str, Writer] = {
    "anipose": write_anipose,
    "pose2sim": write_pose2sim,
    "caliscope": write_caliscope,
    "qualisys": write_qualisys,
    "panoptic": write_panoptic,
    "easymocap": write_easymocap,
    "opencv": write_opencv,
}


def write(format: str, folder: Path, cameras: tuple[Known, ...] = KNOWN) -> Path:
    """Write cameras as a program writes them; return the file."""
    return WRITERS[format](folder, cameras)


def pixels(camera: Known) -> Floats:
    """Return `(40, 2)` pixels of the known points."""
    return np.array([textbook_pixels(camera, point) for point in POINTS_M])


def with_second(**changes: Any) -> tuple[Known, ...]:
    """Return the known cameras with fields of the second one changed."""
    return (KNOWN[0], replace(KNOWN[1], **changes), KNOWN[2])
