"""3D poses as a table, CSV or Parquet: a row per slot, person and joint."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.base.errors import InputError
from e3pose.model.people import People
from e3pose.model.skeleton import Skeleton
from e3pose.pipeline import SlotRecord
from e3pose.store.export import long_columns, write_tables

FORMATS = (".csv", ".parquet")
CHUNK = 500  # slots whose rows are made at once: each row is a dozen objects


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
    check_poses_path(path)
    seen = (record for record in records if len(record.people))
    parts = iter(lambda: [*islice(seen, CHUNK)], [])
    first = next(parts, [*records[:1]])
    write_tables((_columns(p, skeleton) for p in chain([first], parts)), path, path.suffix[1:])


def _columns(records: Sequence[SlotRecord], skeleton: Skeleton) -> dict[str, Any]:
    people = People.joined([record.people for record in records], len(skeleton))
    counts = [len(record.people) for record in records]
    times = np.repeat(np.array([r.time_s for r in records], dtype=np.float64), counts)
    slots = np.repeat(np.array([r.slot for r in records], dtype=np.int64), counts)
    return long_columns({"slot": slots, "time": times.round(6)}, people, skeleton.joints)
