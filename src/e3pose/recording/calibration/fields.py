"""Read and validate the fields of untrusted calibration files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from e3pose.base.arrays import Floats
from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.model.camera_fields import safe_id
from e3pose.model.distortion import LENGTHS
from e3pose.model.rotations import rotation_of

MAX_BYTES = 2_000_000  # a thousand cameras fit
MAX_CAMERAS = 2000
MAX_VALUES = 64  # no field of a camera has more numbers
MAX_ANGLE = 100.0  # radians; beyond, a "rotation vector" is something else
PLAUSIBLE_M = 100.0  # cameras farther apart are more likely in other units
METRES_PER_UNIT = {
    "m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0,
    "cm": 0.01, "centimeter": 0.01, "centimeters": 0.01, "centimetre": 0.01, "centimetres": 0.01,
    "mm": 0.001, "millimeter": 0.001, "millimeters": 0.001, "millimetre": 0.001,
    "millimetres": 0.001,
}  # fmt: skip


def read_text(path: Path) -> str:
    """Return the text of a calibration file; raise `InputError` if it cannot be one."""
    data = read_bytes(path, MAX_BYTES)
    if not data.strip():
        raise InputError(f"{path}: file is empty, expected a calibration")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: found bytes that are not UTF-8 text") from None


def table(value: object, where: str) -> Mapping[str, Any]:
    """Return `value` if it is a table of named fields.

    Raises:
        InputError: for anything else.
    """
    if not isinstance(value, Mapping):
        raise InputError(f"{where}: found {_shown(value)}, expected named fields")
    return value


def field(fields: Mapping[str, Any], name: str, where: str) -> Any:
    """Return a field that must be there.

    Raises:
        InputError: when it is missing.
    """
    if name not in fields:
        raise InputError(f"{where}: {name}: found nothing, expected a value")
    return fields[name]


def numbers(value: object, shapes: Sequence[tuple[int, ...]], where: str) -> Floats:
    """Return finite numbers in one of the `shapes`; an empty sequence of shapes asks for a list.

    Values may be numbers or, from formats that keep text, strings of numbers. A matrix of the right
    number of values in another arrangement, such as a column for a row, is rearranged only if that
    arrangement has one dimension of size one.

    Raises:
        InputError: for other shapes, text, NaN or infinity.
    """
    flat: list[float] = []
    shape = _flatten(value, flat, where, depth=0)
    array = np.array(flat, dtype=np.float64)
    if not np.isfinite(array).all():
        raise InputError(f"{where}: found a value that is not finite, expected numbers")
    squeezed = tuple(size for size in shape if size != 1)
    if not shapes:
        if len(squeezed) > 1:
            raise InputError(f"{where}: found numbers of shape {shape}, expected a list")
        return array
    for wanted in shapes:
        if shape == wanted or squeezed == tuple(size for size in wanted if size != 1):
            return array.reshape(wanted)
    expected = " or ".join(str(wanted) for wanted in shapes)
    raise InputError(f"{where}: found numbers of shape {shape}, expected {expected}")


def scalar(value: object, where: str) -> float:
    """Return one finite number.

    Raises:
        InputError: for anything else, NaN or infinity.
    """
    number = _number(value, where)
    if not math.isfinite(number):
        raise InputError(f"{where}: found a value that is not finite, expected a number")
    return number


def name_of(value: object) -> str:
    """Return a camera's name as text."""
    return value if isinstance(value, str) else _shown(value)


def shown_title(name: str) -> str:
    """Return a name as people read it: one line, at most 64 characters."""
    return "".join(char for char in name if char.isprintable()).strip()[:64]


def units_of(value: object, where: str) -> float:
    """Return how many metres a unit has.

    Raises:
        InputError: for units other than m, cm and mm.
    """
    key = value.strip().lower() if isinstance(value, str) else ""
    if key not in METRES_PER_UNIT:
        raise InputError(f"{where}: units: found {_shown(value)}, expected m, cm or mm")
    return METRES_PER_UNIT[key]


def rotation_matrix(rotation: Floats) -> Floats:
    """Return `(3, 3)` from a rotation matrix or a `(3,)` Rodrigues vector (axis times angle)."""
    if rotation.shape == (3, 3):
        return rotation
    if np.abs(rotation).max() > MAX_ANGLE:
        return np.zeros((3, 3))  # refused as not orthonormal
    return rotation_of(rotation)


def rotation_vector(rotation: Floats) -> Floats:
    """Return the `(3,)` Rodrigues vector of a `(3, 3)` rotation, angle in [0, pi]."""
    from scipy.spatial.transform import Rotation  # takes longer to import than all else here

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec(), dtype=np.float64)


def make_camera(
    path: Path,
    name: str,
    image_size: ArrayLike,
    K: Floats,
    rotation: Floats,
    translation_m: Floats,
    distortion: Floats,
    fisheye: bool = False,
    title: str = "",
) -> Camera:
    """Make a camera from a file's fields.

    Args:
        path: the file, for errors.
        name: of the camera in the file, from which its id is made.
        image_size: `(2,)` width and height, pixels.
        K: `(3, 3)` intrinsics, pixels.
        rotation: `(3, 3)` world to camera.
        translation_m: `(3,)` world to camera, metres.
        distortion: OpenCV coefficients of the lens model.
        fisheye: whether they are those of OpenCV's fisheye model.
        title: what people call it; its name in the file where that is no id.

    Raises:
        InputError: naming file, camera and field.
    """
    camera_id = safe_id(name)
    width, height = np.asarray(image_size, dtype=np.float64)
    if not fisheye and len(distortion) in LENGTHS[4:]:  # OpenCV pads with zeros
        distortion = distortion[: next(n for n in LENGTHS[3:] if not distortion[n:].any())]
    try:
        if width != int(width) or height != int(height):
            raise InputError(
                f"camera {name[:80]}: image size: found ({width:g}, {height:g}), "
                "expected whole pixels"
            )
        camera = Camera.from_world_to_camera(
            camera_id,
            (int(width), int(height)),
            K,
            rotation_matrix(rotation),
            translation_m,
            distortion,
            fisheye,
        )
        return replace(camera, title=title or ("" if camera_id == name else shown_title(name)))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def make_rig(
    path: Path,
    cameras: Sequence[Camera],
    assumed_units: str | None,
    notes: list[str],
    unplaced: Sequence[int] = (),
) -> Rig:
    """Make the rig of a file.

    Args:
        path: for messages.
        cameras: as read, in metres.
        assumed_units: what the lengths were taken for, checked for plausibility; None if the file
            states its units, which is trusted.
        notes: take which id a camera has whose name is none.
        unplaced: indices of cameras whose lens the file has, and no place.

    Raises:
        InputError: for no camera, too many, two of one name, or implausible distances.
    """
    if len(cameras) > MAX_CAMERAS:
        raise InputError(f"{path}: found {len(cameras)} cameras, expected at most {MAX_CAMERAS}")
    if not cameras:
        raise InputError(f"{path}: found no camera, expected at least one")
    named: dict[str, Camera] = {}
    exact = {camera.camera_id for camera in cameras if not camera.title}
    for camera in cameras:
        camera_id, number = camera.camera_id, 2
        while camera.title and camera_id in exact.union(named):  # cleaned names may meet
            camera_id, number = f"{camera.camera_id[:60]}_{number}", number + 1
        if camera.title:
            notes.append(f"camera {camera.title!r} is called {camera_id}")
        if camera_id in named:
            raise InputError(f"{path}: camera id {camera_id!r} appears twice, expected unique ids")
        named[camera_id] = replace(camera, camera_id=camera_id)
    lost = tuple(list(named)[index] for index in unplaced)
    try:
        rig = Rig(tuple(named.values()), len(lost) < len(cameras), lost)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if assumed_units is not None:
        own = rig.placed_ones or [0]
        apart_m = np.linalg.norm(rig.centers_m[own] - rig.centers_m[own[0]], axis=1)
        extent = float(apart_m.max())
        if extent > PLAUSIBLE_M:
            farthest = rig.camera_ids[own[int(apart_m.argmax())]]
            raise InputError(
                f"{path}: camera {farthest}: translation: found cameras {extent:.4g} m apart when "
                f"lengths are read as {assumed_units}, expected at most {PLAUSIBLE_M:g} m; are "
                "they millimetres or centimetres? "
                '(a TOML file can say so: [metadata] units = "mm")'
            )
        if len(own) > 1 and extent < 0.01:
            raise InputError(
                f"{path}: camera {rig.camera_ids[own[1]]}: translation: found all cameras within "
                f"{extent * 1000:.2g} mm when lengths are read as {assumed_units}, "
                "expected at least 10 mm; is the file in other units, or not yet calibrated?"
            )
    return rig


def _flatten(value: object, flat: list[float], where: str, depth: int) -> tuple[int, ...]:
    if isinstance(value, Mapping):
        return _flatten_matrix(value, flat, where)
    if not isinstance(value, (list, tuple)):
        flat.append(_number(value, where))
        if len(flat) > MAX_VALUES:
            raise InputError(f"{where}: found more than {MAX_VALUES} numbers")
        return ()
    if depth >= 3:
        raise InputError(f"{where}: found lists within lists, expected at most a matrix")
    if len(value) > MAX_VALUES:
        raise InputError(f"{where}: found {len(value)} values, expected at most {MAX_VALUES}")
    shapes = {_flatten(item, flat, where, depth + 1) for item in value}
    if len(shapes) > 1:
        raise InputError(f"{where}: found rows of different lengths, expected a matrix")
    return (len(value), *(shapes.pop() if shapes else ()))


def _flatten_matrix(value: Mapping[Any, Any], flat: list[float], where: str) -> tuple[int, ...]:
    """Read OpenCV's matrix: rows and cols, or the sizes of OpenCV 5, and the data row by row."""
    data, sizes = value.get("data"), value.get("sizes", [value.get("rows"), value.get("cols")])
    if not isinstance(data, list) or not isinstance(sizes, list) or len(sizes) > 3:
        raise InputError(f"{where}: found named fields, expected a matrix of rows, cols and data")
    shape = tuple(scalar(size, f"{where}: size") for size in sizes)
    if len(data) > MAX_VALUES or math.prod(shape) != len(data):
        expected = " x ".join(f"{size:g}" for size in shape)
        raise InputError(
            f"{where}: found {len(data)} numbers, expected {expected} (at most {MAX_VALUES})"
        )
    flat.extend(_number(item, where) for item in data)
    return tuple(int(size) for size in shape)


def _number(value: object, where: str) -> float:
    if not isinstance(value, (int, float, str)) or isinstance(value, bool):
        raise InputError(f"{where}: found {_shown(value)}, expected a number")
    try:
        return float(value)
    except (ValueError, OverflowError):
        raise InputError(f"{where}: found {_shown(value)}, expected a number") from None


def _shown(value: object) -> str:
    """Return a short form that no hostile value can blow up or break into lines."""
    if isinstance(value, str):
        return repr(value[:60])
    if isinstance(value, int) and abs(value) >= 10**18:
        return "a huge number"
    if value is None or isinstance(value, (int, float)):
        return str(value)
    return f"a {type(value).__name__}"
