"""3D poses as a table, CSV or Parquet: a row per slot, person and joint."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError
from e3pose.model.people import People
from e3pose.model.skeleton import Skeleton
from e3pose.pipeline import SlotRecord

FORMATS = (".csv", ".parquet")
DECIMALS_M = 5  # hundredths of a millimetre: below any camera's noise


def check_poses_path(path: Path) -> Path:
    """Return `path` if its ending names a format; raise `InputError` if not."""
    if path.suffix not in FORMATS:
        raise InputError(f"{path}: ending {path.suffix!r}, expected {' or '.join(FORMATS)}")
    if path.is_dir():
        raise InputError(f"{path}: is a folder, expected a file to write")
    return path


def write_poses(records: Sequence[SlotRecord], skeleton: Skeleton, path: Path) -> None:
    """Write every estimated joint of every slot; a missing joint has no row.

    Args:
        records: of a replay or a live run, in slot order.
        skeleton: names the joints, snake_case.
        path: a `.csv` or `.parquet` file, metres; it appears whole or not at all.

    Raises:
        InputError: when the file's ending names no known format.
    """
    import pyarrow
    from pyarrow import csv, parquet

    check_poses_path(path)
    table = pyarrow.table(_columns(records, skeleton))
    with atomic_file(path) as temporary:
        if path.suffix == ".csv":
            with temporary.open("wb") as file:
                file.write(",".join(table.column_names).encode() + b"\n")
                plain = csv.WriteOptions(include_header=False, quoting_style="none")
                csv.write_csv(table, file, plain)
        else:
            parquet.write_table(table, temporary, compression="zstd")


def _columns(records: Sequence[SlotRecord], skeleton: Skeleton) -> dict[str, Any]:
    people = People.joined([record.people for record in records], len(skeleton))
    counts = [len(record.people) for record in records]
    person, joint = np.nonzero(people.scores > 0)
    slots = np.repeat(np.array([r.slot for r in records], dtype=np.int64), counts)
    times = np.repeat(np.array([r.time_s for r in records], dtype=np.float64), counts)
    positions = people.joints_m[person, joint].round(DECIMALS_M)
    sigma = people.sigma_m[person, joint].round(DECIMALS_M)
    return {
        "slot": slots[person],
        "time": times[person].round(6),
        "track": people.track_ids[person],
        "joint": np.array(skeleton.joints, dtype=str)[joint].tolist(),
        "x": positions[:, 0],
        "y": positions[:, 1],
        "z": positions[:, 2],
        "score": people.scores[person, joint].round(4),
        "measured": people.measured[person, joint],
        "sigma": [None if np.isnan(value) else value for value in sigma],
    }
