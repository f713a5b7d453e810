"""Forget people in files that `query`, `replay` and `export` wrote as tables."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from e3pose.base.atomic import atomic_file, write_file
from e3pose.base.errors import InputError, reason_of

FORMS = (".csv", ".json", ".parquet")
WANTED = "a store, or a table with a column track: .csv, .json, .parquet; delete other files"


def forget_rows(path: Path, tracks: Sequence[tuple[int, int]]) -> int:
    """Remove the rows of tracks from a file; return how many there were.

    Args:
        path: a table by `query`, `replay --poses` or `export`, with an ending of `FORMS`. One
            without runs is of one.
        tracks: runs and tracks.

    Raises:
        InputError: for a file with another content.
    """
    remove = {".csv": _csv, ".json": _json, ".parquet": _parquet}[path.suffix.lower()]
    try:
        return remove(path, tracks)
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(str(path), reason_of(error)[:200], WANTED) from None


def _is_of(row: Mapping[str, Any], tracks: Sequence[tuple[int, int]]) -> bool:
    """Return whether a row is about one of the tracks."""
    if row["track"] in (None, ""):
        return False
    track = int(row["track"])
    return any(track == t and int(row.get("run", run)) == run for run, t in tracks)


def _csv(path: Path, tracks: Sequence[tuple[int, int]]) -> int:
    removed = 0
    with path.open(newline="", encoding="utf-8") as source:
        reader = csv.DictReader(source)
        names = reader.fieldnames or ()
        if "track" not in names:
            raise ValueError("no column track")
        with (
            atomic_file(path, private=True) as temporary,
            temporary.open("w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.DictWriter(file, names, lineterminator="\n")
            writer.writeheader()
            for row in reader:
                gone = _is_of(row, tracks)
                removed += gone
                if not gone:
                    writer.writerow(row)
    return removed


def _json(path: Path, tracks: Sequence[tuple[int, int]]) -> int:
    rows = json.loads(path.read_bytes())
    if not isinstance(rows, list) or not all(isinstance(r, dict) and "track" in r for r in rows):
        raise ValueError("no list of rows with track")
    kept = [row for row in rows if not _is_of(row, tracks)]
    lines = ",\n".join(json.dumps(row, separators=(",", ":")) for row in kept)
    write_file(path, f"[\n{lines}\n]\n" if kept else "[\n]\n", private=True)
    return len(rows) - len(kept)


def _parquet(path: Path, tracks: Sequence[tuple[int, int]]) -> int:
    import pyarrow.compute as compute
    from pyarrow import parquet

    removed = 0
    with parquet.ParquetFile(path) as source, atomic_file(path, private=True) as temporary:
        schema = source.schema_arrow
        if "track" not in schema.names:
            raise ValueError("no column track")
        with parquet.ParquetWriter(temporary, schema, compression="zstd") as writer:
            for table in source.iter_batches():
                gone = compute.is_null(table["track"])
                gone = compute.and_(gone, compute.invert(gone))  # none
                for run, track in tracks:
                    mine = compute.equal(table["track"], track)
                    if "run" in schema.names:
                        mine = compute.and_(mine, compute.equal(table["run"], run))
                    gone = compute.or_(gone, compute.fill_null(mine, False))
                kept = table.filter(compute.invert(gone))
                removed += len(table) - len(kept)
                writer.write_batch(kept)
    return removed
