"""Write query results as CSV, Parquet or JSON, in chunks."""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import msgspec
import numpy as np

from e3pose.base.atomic import atomic_file
from e3pose.model.people import People
from e3pose.store.answers import StoredPoses
from e3pose.store.times import iso_text

Columns = Mapping[str, Sequence[Any]]

DECIMALS_M = 5  # hundredths of a millimetre: below any camera's noise


class Sink(Protocol):
    """Takes the rows of a table, some columns at a time."""

    def write(self, columns: Columns) -> None:
        """Append rows; every call has the same columns, of equal length."""


def pose_columns(poses: StoredPoses) -> dict[str, list[Any]]:
    """Return one row per person, slot and joint that was seen; metres, times as ISO 8601 UTC."""
    times = [iso_text(ns) for ns in poses.time_ns.tolist()]
    when = {"run": poses.run_ids, "slot": poses.slots, "time": times, "time_ns": poses.time_ns}
    return long_columns(when, poses.people, poses.joints)


def long_columns(
    when: Mapping[str, Any], people: People, joints: Sequence[str]
) -> dict[str, list[Any]]:
    """Return one row per person, slot and joint that has a place: the long layout.

    Args:
        when: columns of one value for each row of `people`.
        people: metres; a joint of score 0 has no row.
        joints: their names.
    """
    person, joint = np.nonzero(people.scores > 0)
    positions = people.joints_m[person, joint].astype(np.float64).round(DECIMALS_M)
    sigma = people.sigma_m[person, joint].astype(np.float64).round(DECIMALS_M)
    return {
        **{name: np.array(values)[person].tolist() for name, values in when.items()},
        "track": people.track_ids[person].tolist(),
        "joint": np.array(joints, dtype=object)[joint].tolist(),
        **{axis: positions[:, i].tolist() for i, axis in enumerate("xyz")},
        "score": people.scores[person, joint].astype(np.float64).round(4).tolist(),
        "measured": people.measured[person, joint].tolist(),
        "sigma": [None if np.isnan(value) else value for value in sigma.tolist()],
    }


def row_columns(
    rows: Sequence[Mapping[str, Any]], names: Sequence[str] = ()
) -> dict[str, list[Any]]:
    """Return rows by name as columns, with a time as ISO 8601 before the nanoseconds.

    Args:
        rows: by name.
        names: of the columns where there are no rows.
    """
    columns: dict[str, list[Any]] = {}
    for name in rows[0] if rows else names:
        values = [row[name] for row in rows]
        if name.endswith("_ns") and name != "interval_ns":
            columns[name.removesuffix("_ns")] = [
                None if value is None else iso_text(value) for value in values
            ]
        columns[name.removesuffix("_id") if name in ("run_id", "track_id") else name] = values
    return columns


def write_tables(chunks: Iterable[Columns], path: Path | None, form: str) -> int:
    """Write chunks of one table into a file that appears whole or not at all.

    Args:
        chunks: parts of the table with the same columns; the first says which.
        path: where to; None for standard output.
        form: `csv`, `parquet` or `json`.

    Returns:
        How many rows were written.
    """
    count = 0
    sinks = {"csv": _csv, "parquet": _parquet, "json": _json}
    with _opened(path) as file, sinks[form](file) as sink:
        for columns in chunks:
            count += len(next(iter(columns.values()), ()))
            sink.write(columns)
    return count


@contextmanager
def _opened(path: Path | None) -> Iterator[BinaryIO]:
    if path is None:
        sys.stdout.flush()
        with open(sys.stdout.fileno(), "wb", closefd=False) as file:
            yield file
    else:
        with atomic_file(path, private=True) as temporary, temporary.open("wb") as file:
            yield file


class _Csv:
    def __init__(self, file: Any) -> None:
        self._writer, self._begun = csv.writer(file, lineterminator="\n"), False

    def write(self, columns: Columns) -> None:
        if not self._begun:
            self._writer.writerow(columns)
            self._begun = True
        self._writer.writerows(zip(*columns.values(), strict=True))


class _Json:
    def __init__(self, file: Any) -> None:
        self._file, self._begun = file, False

    def write(self, columns: Columns) -> None:
        names = list(columns)
        for values in zip(*columns.values(), strict=True):
            self._file.write(b",\n" if self._begun else b"\n")
            self._file.write(msgspec.json.encode(dict(zip(names, values, strict=True))))
            self._begun = True


class _Parquet:
    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._writer: Any = None

    def write(self, columns: Columns) -> None:
        import pyarrow
        from pyarrow import parquet

        if self._writer is None:
            schema = pyarrow.schema([(n, _arrow_type(n, v)) for n, v in columns.items()])
            self._writer = parquet.ParquetWriter(self._file, schema, compression="zstd")
        arrays = {
            # The text has microseconds; Parquet keeps the nanoseconds as a time of its own kind.
            name: pyarrow.array(columns.get("time_ns", values) if name == "time" else values).cast(
                self._writer.schema.field(name).type
            )
            for name, values in columns.items()
        }
        self._writer.write_table(pyarrow.table(arrays, schema=self._writer.schema))

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()


@contextmanager
def _csv(file: BinaryIO) -> Iterator[Sink]:
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    try:
        yield _Csv(text)
    finally:
        text.detach()


@contextmanager
def _json(file: BinaryIO) -> Iterator[Sink]:
    file.write(b"[")
    yield _Json(file)
    file.write(b"\n]\n")


@contextmanager
def _parquet(file: BinaryIO) -> Iterator[Sink]:
    sink = _Parquet(file)
    try:
        yield sink
    finally:
        sink.close()


def _arrow_type(name: str, values: Sequence[Any]) -> Any:
    import pyarrow

    first = next((value for value in values if value is not None), None)
    if name == "time" and not isinstance(first, float):  # of a run without dates, seconds
        return pyarrow.timestamp("ns", tz="UTC")
    if isinstance(first, list):
        return pyarrow.list_(pyarrow.float32())
    if isinstance(first, bool) or name == "measured":
        return pyarrow.bool_()
    if isinstance(first, str) or name in ("joint", "camera_id"):
        return pyarrow.string()
    if isinstance(first, int) or name.endswith("_ns") or name in ("run", "slot", "track"):
        return pyarrow.int64()
    return pyarrow.float64()
