"""Points that somebody else found in the views: a ball, a marker, clicked corners."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from e3pose.errors import InputError
from e3pose.files.bounded import read_bytes
from e3pose.geometry.camera import Rig

Floats = NDArray[np.float64]

MAX_BYTES = 200_000_000
MAX_POINTS = 1_000_000
COLUMNS = ("time", "camera", "u", "v")


def load_points(path: Path, rig: Rig) -> Floats:
    """Read points by camera and time.

    A `.csv` has the columns time, camera, u, v, and optionally point, for several points at one
    time. An `.npz` has one array by camera id, `(num_times, 2)` or `(num_times, num_points, 2)`;
    NaN where not seen.

    Returns:
        `(num_cameras, num_points, 2)` pixels, NaN where not seen.

    Raises:
        InputError: naming the file, and the line or array that is wrong.
    """
    if path.suffix.lower() == ".npz":
        return _from_npz(path, rig)
    if path.suffix.lower() == ".csv":
        return _from_csv(path, rig)
    raise InputError(f"{path}: found {path.suffix or 'no suffix'}, expected .csv or .npz")


def _from_csv(path: Path, rig: Rig) -> Floats:
    try:
        text = read_bytes(path, MAX_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: found bytes that are not UTF-8 text") from None
    rows = csv.DictReader(io.StringIO(text))
    lacking = [name for name in COLUMNS if name not in (rows.fieldnames or ())]
    if lacking:
        raise InputError(f"{path}:1: found no column {lacking[0]}, expected {', '.join(COLUMNS)}")
    keys: dict[tuple[str, str], int] = {}
    found: list[tuple[int, int, float, float]] = []
    for number, row in enumerate(rows, 2):
        try:
            camera = rig.index(row["camera"] or "")
            u, v = float(row["u"]), float(row["v"])
        except (InputError, ValueError, TypeError) as error:
            raise InputError(f"{path}:{number}: {error}") from None
        key = (row["time"] or "", row.get("point") or "")
        found.append((camera, keys.setdefault(key, len(keys)), u, v))
        if len(keys) > MAX_POINTS:
            raise InputError(f"{path}: found more than {MAX_POINTS} points")
    points = np.full((len(rig), len(keys), 2), np.nan)
    for camera, index, u, v in found:
        points[camera, index] = u, v
    return points


def _from_npz(path: Path, rig: Rig) -> Floats:
    if not path.is_file():
        raise InputError(f"{path}: found no file")
    arrays = {}
    try:
        with np.load(path, allow_pickle=False) as file:
            for name in file.files:
                rig.index(name)
                arrays[name] = np.asarray(file[name], dtype=np.float64)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except Exception as error:  # zip and numpy raise what they please on broken files
        raise InputError(f"{path}: cannot be read as .npz ({type(error).__name__})") from None
    sizes = {array.shape for array in arrays.values()}
    if len(sizes) != 1:
        raise InputError(f"{path}: found arrays of shapes {sorted(sizes)}, expected one shape")
    (shape,) = sizes
    if len(shape) not in (2, 3) or shape[-1] != 2 or np.prod(shape[:-1]) > MAX_POINTS:
        raise InputError(
            f"{path}: found arrays of shape {shape}, expected (num_times, 2) or "
            "(num_times, num_points, 2)"
        )
    points = np.full((len(rig), int(np.prod(shape[:-1])), 2), np.nan)
    for name, array in arrays.items():
        points[rig.index(name)] = array.reshape(-1, 2)
    return points
