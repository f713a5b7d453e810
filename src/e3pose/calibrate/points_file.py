"""Read points marked in the views by other tools: a ball, a marker, clicked corners."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError, reason_of
from e3pose.base.quantities import plural
from e3pose.model.camera import Rig
from e3pose.recording.arrays import BROKEN, open_archive, read_array

MAX_BYTES = 200_000_000
MAX_POINTS = 1_000_000
COLUMNS = ("time", "camera", "u", "v")


def load_points(path: Path, rig: Rig) -> Floats:
    """Read points by camera and time.

    A `.csv` has the columns time, camera, u, v, and optionally point, for several points at one
    time. An `.npz` has one array by camera id, `(num_times, 2)` or `(num_times, num_points, 2)`;
    NaN where not seen.

    Returns:
        `(num_cameras, num_points, 2)` pixels, NaN where not seen; a point is another at each time.

    Raises:
        InputError: naming the file, and the line or array that is wrong.
    """
    points, _ = _read(path, rig)
    flat = points.reshape(len(rig), -1, 2)
    return np.asarray(flat[:, np.isfinite(flat[..., 0]).any(axis=0)])


def load_markers(path: Path, rig: Rig, markers: Sequence[str]) -> Floats:
    """Read the markers of a wand, which the column `point` of a `.csv` names.

    In an `.npz` they are the points in their order.

    Returns:
        `(num_cameras, num_times, num_markers, 2)` pixels, NaN where not seen.

    Raises:
        InputError: as `load_points`, and naming a marker that is not there.
    """
    points, names = _read(path, rig)
    if names is None and points.shape[2] == len(markers):
        return points
    lacking = [marker for marker in markers if marker not in (names or ())]
    if names is None or lacking:
        found = plural(points.shape[2], "point") if names is None else f"{', '.join(names)[:60]}"
        wanted = ", ".join(markers) if names is not None else plural(len(markers), "point")
        raise InputError("points of one time", found, f"{wanted} as in --wand", str(path))
    return np.asarray(points[:, :, [names.index(marker) for marker in markers]])


def _read(path: Path, rig: Rig) -> tuple[Floats, list[str] | None]:
    """Return `(num_cameras, num_times, num_points, 2)` pixels, and what the points are called."""
    if path.suffix.lower() == ".npz":
        return _from_npz(path, rig), None
    if path.suffix.lower() != ".csv":
        raise InputError(f"{path}: found {path.suffix or 'no suffix'}, expected .csv or .npz")
    try:
        text = read_bytes(path, MAX_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: found bytes that are not UTF-8 text") from None
    rows = csv.DictReader(io.StringIO(text))
    lacking = [name for name in COLUMNS if name not in (rows.fieldnames or ())]
    if lacking:
        raise InputError(f"{path}:1: found no column {lacking[0]}, expected {', '.join(COLUMNS)}")
    times: dict[str, int] = {}
    names: dict[str, int] = {}
    found: list[tuple[int, int, int, float, float]] = []
    for number, row in enumerate(rows, 2):
        try:
            camera = rig.index(row["camera"] or "")
            u, v = float(row["u"]), float(row["v"])
        except (InputError, ValueError, TypeError) as error:
            raise InputError(f"{path}:{number}: {error}") from None
        time = times.setdefault(row["time"] or "", len(times))
        name = names.setdefault(row.get("point") or "", len(names))
        found.append((camera, time, name, u, v))
        if len(times) * len(names) > MAX_POINTS:
            raise InputError(f"{path}: found more than {MAX_POINTS} points")
    points = np.full((len(rig), len(times), len(names), 2), np.nan)
    for camera, time, name, u, v in found:
        points[camera, time, name] = u, v
    return points, list(names)


def _from_npz(path: Path, rig: Rig) -> Floats:
    arrays = {}
    try:
        with open_archive(path) as archive:
            for entry in archive.infolist():
                name = entry.filename.removesuffix(".npy")
                rig.index(name)
                with archive.open(entry) as member:
                    array = read_array(member, min(entry.file_size, 16 * MAX_POINTS), "fiu")
                arrays[name] = array.astype(np.float64)
    except InputError as error:
        raise error.at(path) from None
    except BROKEN as error:
        raise InputError(f"{path}: cannot be read as .npz ({reason_of(error)[:200]})") from None
    sizes = {array.shape for array in arrays.values()}
    if len(sizes) != 1:
        raise InputError(f"{path}: found arrays of shapes {sorted(sizes)}, expected one shape")
    (shape,) = sizes
    if len(shape) not in (2, 3) or shape[-1] != 2 or np.prod(shape[:-1]) > MAX_POINTS:
        raise InputError(
            f"{path}: found arrays of shape {shape}, expected (num_times, 2) or "
            "(num_times, num_points, 2)"
        )
    points = np.full((len(rig), shape[0], shape[1] if len(shape) == 3 else 1, 2), np.nan)
    for name, array in arrays.items():
        points[rig.index(name)] = array.reshape(points.shape[1:])
    return points
