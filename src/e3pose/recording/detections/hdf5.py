"""Detections in HDF5: SLEAP's analysis files and DeepLabCut's tables, by plain datasets alone.

Pandas keeps the names of columns as pickled Python. Their opcodes are read as text, and never run.
"""

from __future__ import annotations

import pickletools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.bounded import open_regular
from e3pose.base.errors import InputError, reason_of
from e3pose.base.installing import install_command
from e3pose.recording.arrays import BROKEN
from e3pose.recording.detections.forms import MAX_FILE_BYTES, Pictures, of_array, of_columns

if TYPE_CHECKING:
    import h5py

TEXTS = ("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "STRING", "BINSTRING", "SHORT_BINSTRING")
SCORERS = 4  # levels of a column: scorer, individual, body part, coordinate
CSV = "as CSV: deeplabcut.analyze_videos_converth5_to_csv(FOLDER)"


def read_hdf5(path: Path) -> Pictures:
    """Read a file of one camera.

    Raises:
        InputError: for another content, and without h5py.
    """
    try:
        import h5py
    except ImportError:
        wanted = f"{install_command('hdf5')}, or the detections {CSV}"
        raise InputError(f"{path}: HDF5 needs h5py: {wanted}") from None
    with open_regular(path, MAX_FILE_BYTES) as raw:
        try:
            with h5py.File(raw, "r") as file:
                if {"tracks", "node_names"} <= {*file}:
                    return _sleap(file, path)
                for name in file:
                    group = _member(file, name, path)
                    if isinstance(group, h5py.Group) and "table" in group:
                        return _table(_member(group, "table", path), path)
        except InputError:
            raise
        except (*BROKEN, AttributeError) as error:
            raise InputError(f"{path}: {reason_of(error)[:200]}") from None
    wanted = f"tracks and node_names of SLEAP's analysis, or a table of DeepLabCut; else {CSV}"
    raise InputError(f"{path}: found neither, expected {wanted}")


def _member(group: h5py.Group, name: str, path: Path) -> Any:
    """Return a part of a file; raise `InputError` for a link into another file."""
    if type(group.get(name, getlink=True)).__name__ != "HardLink":
        raise InputError(f"{path}: {name[:60]}: found a link, expected data in this file")
    return group[name]


def _values(dataset: Any, path: Path) -> Any:
    """Return the content of a dataset, which must lie in the file and fit into memory.

    Values of variable length lie in a heap, in which a broken file can make the library search
    without an end.
    """
    beyond = dataset.external or dataset.is_virtual or dataset.nbytes > MAX_FILE_BYTES
    if beyond or dataset.dtype.hasobject:
        found = "found data of variable length, in another file, or too large"
        raise InputError(f"{path}: {dataset.name[:60]}: {found}")
    return dataset[()]


def _attribute(dataset: h5py.Dataset, name: str, path: Path) -> Any:
    if name not in dataset.attrs or dataset.attrs.get_id(name).dtype.hasobject:
        raise InputError(f"{path}: found no {name[:60]} of fixed length, expected a table {CSV}")
    return dataset.attrs[name]


def _sleap(file: h5py.File, path: Path) -> Pictures:
    """Read `tracks`: tracks x 2 x nodes x frames, or frames x tracks x nodes x 2; and scores."""
    names = [name.decode() for name in _values(_member(file, "node_names", path), path).tolist()]
    tracks, scores = (
        np.asarray(_values(_member(file, key, path), path), dtype=np.float64)
        if key in file
        else np.ones(0)
        for key in ("tracks", "point_scores")
    )
    python = tracks.shape[2:] == (len(names), 2)
    if not python and tracks.ndim == 4 and tracks.shape[1:3] == (2, len(names)):  # as for MATLAB
        tracks = tracks.transpose(3, 0, 2, 1)
        scores = scores.transpose(2, 0, 1) if scores.ndim == 3 else scores
    if tracks.ndim != 4 or tracks.shape[2:] != (len(names), 2):
        raise InputError(f"{path}: tracks: found shape {tracks.shape}, expected those of SLEAP")
    if scores.shape == tracks.shape[:3]:
        scores = np.where(np.isfinite(scores), scores, 1.0)  # set by hand
        tracks = np.concatenate([tracks, scores[..., None]], axis=-1)
    return of_array(tracks, range(len(tracks)), names, str(path))


def _table(table: h5py.Dataset, path: Path) -> Pictures:
    """Read a table of pandas: an index and blocks of values, whose columns attributes name."""
    rows = _values(table, path)
    columns: list[tuple[str, str, str]] = []
    blocks: list[Floats] = []
    for name in rows.dtype.names or ():
        if name != "index":
            told = columns_of(bytes(_attribute(table, f"{name}_kind", path)), path)
            columns += [(c[1] if len(c) == SCORERS else "single", c[-2], c[-1]) for c in told]
            blocks.append(np.asarray(rows[name], dtype=np.float64).reshape(len(rows), -1))
    values = np.concatenate(blocks, axis=1) if blocks else np.zeros((len(rows), 0))
    if not columns or values.shape[1] != len(columns):
        raise InputError(f"{path}: found no names of columns, expected a table {CSV}")
    index = rows["index"].tolist()
    labels = [label.decode() if isinstance(label, bytes) else int(label) for label in index]
    return of_columns(columns, values, labels, str(path))


def columns_of(pickled: bytes, path: Path) -> list[tuple[str, ...]]:
    """Return the tuples of text in a pickled list, of which nothing is run.

    Raises:
        InputError: for what is no such list.
    """
    found: list[tuple[str, ...]] = []
    stack: list[str] = []
    memo: dict[Any, str] = {}
    try:
        for opcode, value, _ in pickletools.genops(pickled):
            name = opcode.name
            if name in TEXTS:
                stack.append(str(value))
            elif name in ("GET", "BINGET", "LONG_BINGET") and value in memo:
                stack.append(memo[value])
            elif name in ("PUT", "BINPUT", "LONG_BINPUT") and stack:
                memo[value] = stack[-1]
            elif name == "MEMOIZE":
                memo[len(memo)] = stack[-1] if stack else ""
            elif name.startswith("TUPLE"):
                found.append(tuple(stack))
                stack = []
            elif name in ("GLOBAL", "STACK_GLOBAL", "REDUCE", "INST", "OBJ", "BUILD", "NEWOBJ"):
                raise ValueError(f"found {name}")
    except (ValueError, AttributeError, KeyError, UnicodeDecodeError, IndexError) as error:
        why = reason_of(error)[:80]
        raise InputError(f"{path}: names of columns: {why}, expected them {CSV}") from None
    return [column for column in found if len(column) in (SCORERS - 1, SCORERS)]
