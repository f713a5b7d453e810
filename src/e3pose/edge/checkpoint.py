"""Save and restore the state of the loop, so that a killed edge resumes.

The state is a value: nested frozen records of arrays and numbers. It is flattened by field names
and rebuilt along the structure of an initial state; nothing is pickled.
"""

from __future__ import annotations

import io
import json
import math
import struct
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from e3pose.base.atomic import atomic_file
from e3pose.base.bounded import open_regular
from e3pose.base.errors import InputError, reason_of
from e3pose.pipeline import Pipeline, SlotState, initial_state
from e3pose.recording.arrays import BROKEN, read_array
from e3pose.select.failure_detector import RETRY_LIMIT_S

# 1 lacks the run, 2 what links lose, 3 exits and noise, 4 shifts, 5 sides; 6 had another unit of V,
# 7 other names, 8 lacks innovations, 9 has those of the site, 11 lacks failed pairs, 12 agility,
# 13 has exits, 14 lacks the check, 15 who sleeps, 16 what that costs, 17 a file for each array, 18
# lacks sharpness, 19 has shifts, 20 other names of the history, 21 lacks looks.
VERSION = 22
MAX_BYTES = 64 * 2**20  # 28 cameras and 20 people take about one
MAX_ARRAYS = 10_000
MAX_S = 100 * 365.25 * 86400  # of slots
MAX_NS = 2**62  # the year 2116: what is added to it still fits 64 bits
MAX_ID = 2**53
LONGEST_SLEEP_S = 86400.0  # a camera that is told to sleep longer is lost
MAX_VALUE = 1e15  # in whatever unit
ABOUT, VALUES = "about", "values"  # arrays of bytes in the file
KINDS = "biuf"  # of numbers that a state has
FORGOTTEN = {"shown", "focused"}  # of earlier slots, which are over when the edge resumes
DAMAGE = (*BROKEN, struct.error)  # what damaged or foreign archives raise
Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The state of an edge at one time.

    Attributes:
        state: of the loop.
        origin_ns: the middle of slot 0.
        lead_slots: how many slots ahead orders were given.
        made_ns: when it was made.
        run_ns: when the run began that the state belongs to; slots and tracks are unique in it.
    """

    state: SlotState
    origin_ns: int
    lead_slots: int
    made_ns: int
    run_ns: int = 0


def save_checkpoint(path: Path, checkpoint: Checkpoint, pipeline: Pipeline) -> None:
    """Write a checkpoint, whole or not at all."""
    about = {
        "version": VERSION,
        "site": _fingerprint(pipeline),
        "origin_ns": checkpoint.origin_ns,
        "lead_slots": checkpoint.lead_slots,
        "made_ns": checkpoint.made_ns,
        "run_ns": checkpoint.run_ns,
    }
    with atomic_file(path, private=True) as temporary:
        write_arrays(temporary, about, flatten(checkpoint.state))


def write_arrays(path: Path, about: Mapping[str, Any], arrays: Arrays) -> None:
    """Write arrays as one: each of a hundred in an .npz costs as much as all of their numbers."""
    layout = [(name, array.dtype.str, array.shape) for name, array in arrays.items()]
    said = json.dumps({**about, "layout": layout}).encode()
    values = b"".join([array.tobytes() for array in arrays.values()])
    parts = {ABOUT: np.frombuffer(said, np.uint8), VALUES: np.frombuffer(values, np.uint8)}
    made = io.BytesIO()  # whose end no full disk garbles
    np.savez(made, **parts)  # type: ignore[arg-type]
    path.write_bytes(made.getbuffer())


def read_arrays(path: Path) -> tuple[dict[str, Any], Arrays]:
    """Read the arrays of `write_arrays`; raise one of `DAMAGE` for any other file."""
    with open_regular(path, MAX_BYTES) as file:
        parts = _unpacked(file, path.stat().st_size)
    about = json.loads(parts[ABOUT].tobytes())
    values, arrays, at = parts[VALUES].tobytes(), dict[str, NDArray[Any]](), 0
    for name, kind, shape in about.get("layout", ()):
        dtype, lengths = np.dtype(str(kind)), [int(length) for length in shape]
        if dtype.kind not in KINDS or min(lengths, default=0) < 0 or str(name) in arrays:
            raise ValueError(f"found {str(name)[:40]} as {str(kind)[:40]} {str(shape)[:40]}")
        count = math.prod(lengths)
        array = np.frombuffer(values, dtype, count, at) if count else np.empty(0, dtype)
        arrays[str(name)] = array.reshape(lengths).copy()
        at += count * dtype.itemsize
    if at != len(values):
        raise ValueError(f"found {len(values)} bytes of numbers, expected {at}")
    return about, arrays


def load_checkpoint(path: Path, pipeline: Pipeline) -> Checkpoint:
    """Return the checkpoint in a file.

    Raises:
        InputError: when it is damaged, of another version, or of other cameras or joints.
    """
    try:
        about, arrays = read_arrays(path)
        lead, origin, made, run = (
            int(about[key]) for key in ("lead_slots", "origin_ns", "made_ns", "run_ns")
        )
    except InputError:
        raise
    except DAMAGE as error:
        reason = reason_of(error)[:120]
        raise InputError(f"{path}: found no checkpoint ({reason})") from None
    if about.get("version") != VERSION:
        raise InputError(f"{path}: found version {about.get('version')}, expected {VERSION}")
    if about.get("site") != _fingerprint(pipeline):
        raise InputError(f"{path}: found a checkpoint of other cameras, joints or estimator")
    for name, value, low, high in (
        ("lead_slots", lead, 1, 1000),
        ("origin_ns", origin, -MAX_NS, MAX_NS),
        ("made_ns", made, 0, MAX_NS),
        ("run_ns", run, 0, MAX_NS),
    ):
        if not low <= value <= high:
            raise InputError(f"{path}: {name}: found {str(value)[:40]}, expected {low} to {high}")
    pattern = initial_state(replace(pipeline, lead_slots=lead))
    state = rebuild(pattern, arrays, str(path))
    _check_values(flatten(state), len(pipeline.rig), pipeline.interval_s, str(path))
    return Checkpoint(state, origin, lead, made, run)


def forget_people(path: Path, pipeline: Pipeline) -> None:
    """Take all people out of a checkpoint, present and departed.

    What the loop learned of cameras and places stays.

    Raises:
        InputError: as `load_checkpoint`.
    """
    found = load_checkpoint(path, pipeline)
    pattern = initial_state(replace(pipeline, lead_slots=found.lead_slots))
    nobody = flatten(pattern)
    kept = {  # axes that are empty at first are those of people
        name: nobody[name] if nobody[name].size == 0 else array
        for name, array in flatten(found.state).items()
    }
    save_checkpoint(path, replace(found, state=rebuild(pattern, kept, str(path))), pipeline)


def flatten(value: Any, name: str = "state") -> Arrays:
    """Return the arrays and numbers of nested records, by the names of their fields."""
    if is_dataclass(value):
        parts = [(item.name, getattr(value, item.name)) for item in fields(value)]
    elif isinstance(value, tuple):
        parts = [(str(index), item) for index, item in enumerate(value)]
    else:
        return {} if value is None else {name: np.asarray(value)}
    found: Arrays = {}
    for part, item in parts:
        if part not in FORGOTTEN:
            found.update(flatten(item, f"{name}.{part}"))
    return found


def rebuild(
    pattern: Any, arrays: Mapping[str, NDArray[Any]], where: str, name: str = "state"
) -> Any:
    """Return a value with the structure of `pattern` and the arrays of `flatten`.

    An axis that is empty in the pattern may have any length, the same in all arrays of a record.

    Raises:
        InputError: naming the array that is missing or does not fit.
    """
    if isinstance(pattern, tuple):
        return tuple(
            rebuild(item, arrays, where, f"{name}.{index}") for index, item in enumerate(pattern)
        )
    if not is_dataclass(pattern):
        return _leaf(pattern, arrays, where, name)
    changes: dict[str, Any] = {}
    lengths: set[int] = set()
    for item in fields(pattern):
        if item.name in FORGOTTEN or not item.init:
            continue
        like = getattr(pattern, item.name)
        changes[item.name] = rebuild(like, arrays, where, f"{name}.{item.name}")
        if isinstance(like, np.ndarray):
            found = changes[item.name].shape
            lengths |= {n for n, m in zip(found, like.shape, strict=True) if m == 0}
    if len(lengths - {0}) > 1:  # a skeleton may have no bones, a site nobody in it
        raise InputError(f"{where}: {name}: found lengths {sorted(lengths)}, expected one")
    return replace(pattern, **changes)  # type: ignore[type-var]


def _unpacked(file: BinaryIO, size: int) -> Arrays:
    """Return the arrays of an .npz that was not packed: they take no more than its size."""
    with zipfile.ZipFile(file) as archive:
        entries = archive.infolist()
        if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
            raise ValueError("found packed arrays, expected plain ones")
        if len(entries) > MAX_ARRAYS or sum(e.file_size for e in entries) > size:
            raise ValueError(f"found {len(entries)} arrays larger than the file")
        arrays: Arrays = {}
        for entry in entries:
            with archive.open(entry) as member:
                array = read_array(member, entry.file_size, "biufU")
                arrays[entry.filename.removesuffix(".npy")] = array
    return arrays


def _check_values(arrays: Arrays, num_cameras: int, interval_s: float, where: str) -> None:
    """Raise `InputError` for values that no loop produces and that might stop or hang it."""
    slot = int(arrays["state.slot"])
    last_id = max(int(a) for name, a in arrays.items() if name.endswith("next_id")) - 1
    bounds = {  # by the last word of the name; of anything else there is one a slot and camera
        "cameras": (0, num_cameras - 1),
        "next_id": (0, MAX_ID),
        "retry_slot": (0, slot + round(RETRY_LIMIT_S / interval_s) + 1),
        "asleep_until": (0, slot + round(LONGEST_SLEEP_S / interval_s) + 1),
        "track_ids": (0, last_id),
        "tracks": (0, last_id),
        "slot": (-1, slot - 1),  # of a camera's last view
        "counts": (0, (slot + 1) * num_cameras + 2),
    }
    for name, array in arrays.items():
        low, high = bounds.get(name.rpartition(".")[2], bounds["counts"])
        if name == "state.slot":
            low, high = 0, round(MAX_S / interval_s)
        if array.dtype.kind == "f":
            low, high = -round(MAX_VALUE), round(MAX_VALUE)
            array = array[np.isfinite(array)]  # NaN is missing, and inf never
        wrong = array[(array < low) | (array > high)] if array.dtype.kind != "b" else np.empty(0)
        if wrong.size:
            raise InputError(f"{where}: {name}: found {wrong.flat[0]}, expected {low} to {high}")
    if not np.isfinite(arrays["state.deficit"]).all():
        raise InputError(f"{where}: state.deficit: found NaN, expected finite numbers")


def _leaf(like: Any, arrays: Mapping[str, NDArray[Any]], where: str, name: str) -> Any:
    if like is None and name not in arrays:
        return None
    if name not in arrays:
        raise InputError(f"{where}: {name}: not found, expected an array")
    found, pattern = arrays[name], np.asarray(like)
    fits = found.ndim == pattern.ndim and all(
        m in (0, n) for n, m in zip(found.shape, pattern.shape, strict=True)
    )
    if not fits or found.dtype.kind != pattern.dtype.kind:
        raise InputError(
            f"{where}: {name}: found {found.dtype} {found.shape}, "
            f"expected {pattern.dtype} {pattern.shape}"
        )
    if isinstance(like, np.ndarray):
        return found.astype(pattern.dtype)
    return type(like)(found.item())


def _fingerprint(pipeline: Pipeline) -> dict[str, Any]:
    return {
        "cameras": list(pipeline.rig.camera_ids),
        "joints": pipeline.num_joints,
        "interval_us": round(pipeline.interval_s * 1e6),
        "estimator": type(pipeline.estimator).__name__,
    }
