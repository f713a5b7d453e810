"""Keep the state of the loop in a file, so that an edge that was killed goes on where it was.

Everything that one slot hands to the next is a value: nested frozen records of arrays and numbers.
It is taken apart by the names of their fields and put together again after the pattern of an
initial state; nothing is pickled.
"""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.atomic import atomic_file
from e3pose.bounded import read_bytes
from e3pose.errors import InputError
from e3pose.pipeline import Pipeline, SlotState, initial_state

VERSION = 4  # 1 lacks the run, 2 what links lose, 3 doors and how noisy cameras are
MAX_BYTES = 256 * 2**20
ABOUT = "about"
FORGOTTEN = {"shown"}  # of the slot before, which is history when the edge is back
# What numpy and zipfile raise for archives that are none, or no longer.
DAMAGE = (
    ValueError, KeyError, TypeError, OSError, EOFError, RuntimeError, MemoryError,
    zipfile.BadZipFile, zlib.error, struct.error,
)  # fmt: skip
Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A moment of an edge.

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
    arrays = take_apart(checkpoint.state)
    arrays[ABOUT] = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)
    with atomic_file(path, private=True) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def load_checkpoint(path: Path, pipeline: Pipeline) -> Checkpoint:
    """Return the checkpoint in a file.

    Raises:
        InputError: when it is damaged, of another version, or of other cameras or joints.
    """
    content = read_bytes(path, MAX_BYTES)
    try:
        with np.load(BytesIO(content), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        about = json.loads(arrays.pop(ABOUT).tobytes())
        lead, origin, made, run = (
            int(about[key]) for key in ("lead_slots", "origin_ns", "made_ns", "run_ns")
        )
    except DAMAGE as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: found no checkpoint ({reason})") from None
    if about.get("version") != VERSION:
        raise InputError(f"{path}: found version {about.get('version')}, expected {VERSION}")
    if about.get("site") != _fingerprint(pipeline):
        raise InputError(f"{path}: found a checkpoint of other cameras, joints or estimator")
    if not 1 <= lead <= 1000:
        raise InputError(f"{path}: lead_slots: found {lead}, expected 1 to 1000")
    pattern = initial_state(replace(pipeline, lead_slots=lead))
    return Checkpoint(put_together(pattern, arrays, str(path)), origin, lead, made, run)


def take_apart(value: Any, name: str = "state") -> Arrays:
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
            found.update(take_apart(item, f"{name}.{part}"))
    return found


def put_together(pattern: Any, arrays: Mapping[str, NDArray[Any]], where: str) -> Any:
    """Return a value like `pattern`, with the arrays that `take_apart` found.

    An axis that is empty in the pattern may have any length, the same in all arrays of a record.

    Raises:
        InputError: naming the array that is missing or does not fit.
    """
    return _fill(pattern, arrays, where, "state")


def _fill(pattern: Any, arrays: Mapping[str, NDArray[Any]], where: str, name: str) -> Any:
    if isinstance(pattern, tuple):
        return tuple(
            _fill(item, arrays, where, f"{name}.{index}") for index, item in enumerate(pattern)
        )
    if not is_dataclass(pattern):
        return _leaf(pattern, arrays, where, name)
    changes: dict[str, Any] = {}
    lengths: set[int] = set()
    for item in fields(pattern):
        if item.name in FORGOTTEN or not item.init:
            continue
        like = getattr(pattern, item.name)
        changes[item.name] = _fill(like, arrays, where, f"{name}.{item.name}")
        if isinstance(like, np.ndarray):
            found = changes[item.name].shape
            lengths |= {n for n, m in zip(found, like.shape, strict=True) if m == 0}
    if len(lengths - {0}) > 1:  # a skeleton may have no bones, a site nobody in it
        raise InputError(f"{where}: {name}: found lengths {sorted(lengths)}, expected one")
    return replace(pattern, **changes)  # type: ignore[type-var]


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
