"""Wide Parquet, an archive of poses: one row per person and slot, whole millimetres.

Columns, all integers: `slot` and `track`, `measured` and `filled` (bit j for joint j; of a skeleton
of more than 62 joints `measured62`, `filled62` and so on for those from there), then for each
joint `JOINT_x`, `_y`, `_z` and `_sigma` in millimetres, null where missing or unknown; z up.
Rows go person by person, so that neighbours differ little: numbers are stored as differences
(DELTA_BINARY_PACKED), compressed with zstd. What holds for all rows is in the file's metadata,
under `e3pose`, as JSON: `docs/reference/wide-parquet.md`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError
from e3pose.model.skeleton import MAX_JOINTS, Skeleton, own_file, skeleton_of_joints
from e3pose.model.take import FILLED, MEASURED, MISSING, PREDICTED, Motion, Take, check_fit, nowhere
from e3pose.output.exports.base import ExportSettings

FORMAT, VERSION = "e3pose-poses-wide", 1
KEY = b"e3pose"
MM = 1000.0
ROWS_PER_GROUP = 20_000  # rows that are compressed together
BITS = 62  # joints that an integer tells of
FLAGS = (("measured", MEASURED), ("filled", FILLED))
PARTS = ("x", "y", "z", "sigma")
ZSTD_LEVEL = 9
UNKNOWN_SCORE = 1.0  # scores are not archived


def write_wide(take: Take, dest: Path, settings: ExportSettings) -> str:
    """Write all people of a take, person after person."""
    if settings.angles:
        raise InputError("--angles: found with --layout archive, expected --layout wide")
    people = settings.progress(take.motions, len(take.motions), "write")
    return f"{write_people(take, people, dest)} rows, millimetres, z up, version {VERSION}"


def write_people(about: Take, people: Iterable[Motion], dest: Path) -> int:
    """Write people one after the other, so that one at a time is in memory.

    Args:
        about: what holds for all of them; its own people are not written.
        people: each once.
        dest: the file.

    Returns:
        How many rows were written.
    """
    import pyarrow
    from pyarrow import parquet

    schema = _schema(about)
    count, waiting, num_waiting = 0, list[Any](), 0
    with (
        atomic_file(dest, private=True) as temporary,
        parquet.ParquetWriter(temporary, schema, **_encoding(schema)) as writer,
    ):
        for motion in people:
            waiting.append(pyarrow.table(_columns(about.skeleton, motion), schema=schema))
            num_waiting += waiting[-1].num_rows
            if num_waiting >= ROWS_PER_GROUP:
                writer.write_table(pyarrow.concat_tables(waiting))
                count, waiting, num_waiting = count + num_waiting, [], 0
        writer.write_table(pyarrow.concat_tables([schema.empty_table(), *waiting]))
    return count + num_waiting


def without_person(content: bytes, track: int) -> tuple[bytes, int]:
    """Return a wide file without the rows of a person, and how many rows are left."""
    import pyarrow
    from pyarrow import compute, parquet

    made, rows = pyarrow.BufferOutputStream(), 0
    file = parquet.ParquetFile(pyarrow.BufferReader(content))
    with parquet.ParquetWriter(made, file.schema_arrow, **_encoding(file.schema_arrow)) as writer:
        for batch in file.iter_batches(ROWS_PER_GROUP):
            kept = batch.filter(compute.not_equal(batch.column("track"), track))
            writer.write_batch(kept)
            rows += kept.num_rows
    return made.getvalue().to_pybytes(), rows


def is_wide(metadata: Mapping[bytes, bytes] | None) -> bool:
    """Return whether the metadata of a Parquet file is that of a wide one."""
    return KEY in (metadata or {})


def read_wide(path: Path, file: Any, most_joints: int) -> Take:
    """Return the take of a wide file.

    Args:
        path: of the file, for messages.
        file: opened by pyarrow.
        most_joints: that it may have in all its rows.

    Raises:
        InputError: for metadata or columns that no export writes, and what has more, unread.
    """
    schema, num_rows = file.schema_arrow, file.metadata.num_rows
    about = _checked(path, schema.metadata[KEY])
    joints = tuple(about["joints"])
    first = _first_columns(len(joints))
    wanted = [*first, *(f"{joint}_{part}" for joint in joints for part in PARTS)]
    missing = [name for name in wanted if name not in schema.names]
    if missing or any(not str(schema.field(name).type).startswith("int") for name in wanted):
        raise InputError(f"{path}: found no integer column {(missing or ['_x'])[0]}")
    if num_rows * len(joints) > most_joints:
        expected = f"at most {most_joints // len(joints)}"
        raise InputError(f"{path}: found {num_rows} rows, expected {expected}")
    table = file.read(wanted)
    slots, tracks, *flags = (
        table.column(name).fill_null(0).to_numpy().astype(np.int64) for name in first
    )
    values = np.stack([_floats(table.column(name)) for name in wanted[len(first) :]], axis=-1) / MM
    values = values.reshape(len(slots), len(joints), len(PARTS))
    origin = np.full(values.shape[:2], PREDICTED, dtype=np.uint8)
    bits, half = np.arange(len(joints)), len(flags) // 2
    for row, (_, kind) in enumerate(FLAGS):
        words = np.stack(flags[row * half : (row + 1) * half], axis=-1)
        origin[(words[:, bits // BITS] >> bits % BITS) & 1 == 1] = kind
    origin[~np.isfinite(values[..., :3]).all(axis=-1)] = MISSING
    owns = {track: np.flatnonzero(tracks == track) for track in np.unique(tracks).tolist()}
    try:
        skeleton = skeleton_of_joints(joints, about["skeleton"], about.get("own_skeleton", ""))
    except InputError as error:
        raise error.at(path) from None
    held = sum(int(np.ptp(slots[own])) + 1 for own in owns.values())
    check_fit("all tracks", held, len(joints), str(path))
    motions = [
        _motion(path, track, slots[own], values[own], origin[own]) for track, own in owns.items()
    ]
    return Take(about["name"], skeleton, about["interval_s"], tuple(motions), about["started_ns"])


def _first_columns(num_joints: int) -> list[str]:
    """Return the names of the columns before those of joints."""
    more = range(BITS, num_joints, BITS)
    flags = [[name, *(f"{name}{joint}" for joint in more)] for name, _ in FLAGS]
    return ["slot", "track", *flags[0], *flags[1]]


def _schema(about: Take) -> Any:
    import pyarrow

    joints = about.skeleton.joints
    first = _first_columns(len(joints))
    names = [*first, *(f"{joint}_{part}" for joint in joints for part in PARTS)]
    wide = first[2:]
    return pyarrow.schema(
        [(name, pyarrow.int64() if name in wide else pyarrow.int32()) for name in names],
        metadata={KEY: json.dumps(_about(about))},
    )


def _encoding(schema: Any) -> dict[str, Any]:
    return {
        "compression": "zstd",
        "compression_level": ZSTD_LEVEL,
        "use_dictionary": False,
        "column_encoding": dict.fromkeys(schema.names, "DELTA_BINARY_PACKED"),
        "write_statistics": ["slot", "track"],
    }


def _about(take: Take) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": take.name,
        "skeleton": take.skeleton.name,
        "joints": list(take.skeleton.joints),
        "interval_s": take.interval_s,
        "started_ns": take.started_ns,
        **({"own_skeleton": own} if (own := own_file(take.skeleton)) else {}),
        "units": "mm",
        "up": "z",
    }


def _columns(skeleton: Skeleton, motion: Motion) -> dict[str, Any]:
    import pyarrow

    there = np.flatnonzero(motion.known.any(axis=1))
    columns = {
        "slot": pyarrow.array(motion.first + there, type=pyarrow.int32()),
        "track": pyarrow.array(np.full(len(there), motion.track_id), type=pyarrow.int32()),
    }
    for name, origin in FLAGS:
        for begin in range(0, len(skeleton), BITS):
            bits = motion.origin[there][:, begin : begin + BITS] == origin
            flags = bits @ (1 << np.arange(bits.shape[1]))
            columns[f"{name}{begin or ''}"] = pyarrow.array(flags, type=pyarrow.int64())
    values = np.concatenate([motion.joints_m, motion.sigma_m[..., None]], axis=-1)[there]
    for index, joint in enumerate(skeleton.joints):
        for part, letter in enumerate(PARTS):
            columns[f"{joint}_{letter}"] = _integers(values[:, index, part])
    return columns


def _integers(values: Floats) -> Any:
    """Return metres as whole millimetres, null where missing."""
    import pyarrow

    known = np.isfinite(values)
    whole = np.rint(MM * np.where(known, values, 0.0)).astype(np.int32)
    return pyarrow.array(whole, mask=~known)


def _floats(column: Any) -> Floats:
    import pyarrow

    return np.asarray(column.cast(pyarrow.float64()).to_numpy(), dtype=np.float64)


def _motion(
    path: Path, track: int, slots: NDArray[np.int64], values: Floats, origin: NDArray[np.uint8]
) -> Motion:
    order = np.argsort(slots, kind="stable")
    slots = slots[order]
    if (np.diff(slots) == 0).any():
        raise InputError(f"{path}: track {track}: found a slot twice, expected one row each")
    rows = slots - slots[0]
    made = nowhere(track, int(slots[0]), int(rows[-1]) + 1, values.shape[1])
    made.joints_m[rows], made.sigma_m[rows] = values[order, :, :3], values[order, :, 3]
    made.origin[rows] = origin[order]
    made.joints_m[~made.known], made.sigma_m[~made.known] = np.nan, np.nan
    made.scores[made.known] = UNKNOWN_SCORE
    return made


def _checked(path: Path, text: bytes) -> dict[str, Any]:
    """Return the metadata of a file; raise `InputError` where it is not what an export writes."""
    try:
        about = dict(json.loads(text))
        kind = about["format"], about["version"]
        joints, started_ns = about.get("joints", ()), about.get("started_ns")
        good = (
            all(
                isinstance(each, str)
                for each in (
                    about["name"],
                    about["skeleton"],
                    about.get("own_skeleton", ""),
                    *joints,
                )
            )
            and 1 <= len(joints) == len(set(joints)) <= MAX_JOINTS
            and 1e-4 < about["interval_s"] < 1e4
            and (started_ns is None or isinstance(started_ns, int))
        )
    except (ValueError, KeyError, TypeError, RecursionError):
        good, kind = False, (FORMAT, VERSION)
    if kind != (FORMAT, VERSION):
        found = f"{kind[0]} version {kind[1]}"
        raise InputError(f"{path}: found {found[:80]}, expected {FORMAT} version {VERSION}")
    if not good:
        raise InputError(f"{path}: metadata: found no joints and times, expected those of --wide")
    return about
