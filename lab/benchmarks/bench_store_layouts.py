"""Compare ways to lay poses out in SQLite: what they cost to write, to keep and to ask.

The store uses the first; see docs/decisions/0002-store-layout.md.
"""

from __future__ import annotations

import argparse
import sqlite3
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

PEOPLE, JOINTS, WINDOW = 4, 17, 250  # ten seconds at 25 slots per second
BATCH = 2500


@dataclass(frozen=True)
class Layout:
    """One way: its table, the rows of a slot, a question and what its rows become."""

    name: str
    table: str
    rows: Callable[[int], Iterator[tuple[Any, ...]]]
    question: str
    decode: Callable[[list[tuple[Any, ...]]], Any]


RNG = np.random.default_rng(0)
BLOBS = [RNG.normal(size=(JOINTS, 3)).astype("<f4").tobytes() for _ in range(64)]
HALVES = [RNG.random(JOINTS).astype("<f2").tobytes() for _ in range(64)]


def per_person(slot: int) -> Iterator[tuple[Any, ...]]:
    for track in range(PEOPLE):
        at = slot + track
        yield slot, track, slot * 40_000_000, BLOBS[at % 64], HALVES[at % 64], HALVES[at % 63]


def per_slot(slot: int) -> Iterator[tuple[Any, ...]]:
    people = list(per_person(slot))
    ids = np.arange(PEOPLE).tobytes()
    yield slot, slot * 40_000_000, ids, *(b"".join(p[i] for p in people) for i in (3, 4, 5))


def per_joint(slot: int) -> Iterator[tuple[Any, ...]]:
    for track in range(PEOPLE):
        for joint in range(JOINTS):
            yield slot, track, joint, slot * 40_000_000, 1.2 + slot, 2.3, 3.4, 0.5, 0.01


def stacked(rows: list[tuple[Any, ...]]) -> Any:
    return np.frombuffer(b"".join(row[3] for row in rows), "<f4").reshape(-1, JOINTS, 3)


PERSON = "CREATE TABLE p (slot, track, time, joints, scores, sigma{})"
ONE = "SELECT * FROM p WHERE slot BETWEEN ? AND ? AND track = 1"
LAYOUTS = (
    Layout(
        "row per person, key (slot, track)",
        PERSON.format(", PRIMARY KEY (slot, track)") + " WITHOUT ROWID",
        per_person,
        ONE,
        stacked,
    ),
    Layout(
        "row per person, key (track, slot)",
        PERSON.format(", PRIMARY KEY (track, slot)") + " WITHOUT ROWID",
        per_person,
        ONE,
        stacked,
    ),
    Layout(
        "row per person, rowid and index (slot, track)",
        PERSON.format("") + "; CREATE UNIQUE INDEX i ON p (slot, track)",
        per_person,
        ONE,
        stacked,
    ),
    Layout(
        "row per slot, blob of all its people",
        "CREATE TABLE p (slot PRIMARY KEY, time, tracks, joints, scores, sigma) WITHOUT ROWID",
        per_slot,
        "SELECT * FROM p WHERE slot BETWEEN ? AND ?",
        lambda rows: stacked(rows)[1::PEOPLE],
    ),
    Layout(
        "row per joint",
        "CREATE TABLE p (slot, track, joint, time, x, y, z, score, sigma, "
        "PRIMARY KEY (slot, track, joint)) WITHOUT ROWID",
        per_joint,
        ONE,
        np.array,
    ),
)


def measure(layout: Layout, path: Path, slots: int) -> tuple[float, float, float]:
    """Return microseconds of processor and bytes per slot, and milliseconds a question."""
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.executescript(layout.table)
    begin_s = time.process_time()
    for start in range(0, slots, BATCH):
        rows = [row for s in range(start, min(start + BATCH, slots)) for row in layout.rows(s)]
        connection.execute("BEGIN")
        marks = ",".join("?" * len(rows[0]))
        connection.executemany(f"INSERT OR IGNORE INTO p VALUES ({marks})", rows)
        connection.execute("COMMIT")
    write_us = 1e6 * (time.process_time() - begin_s) / slots
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    times_s = []
    for first in RNG.integers(0, slots - WINDOW, 50).tolist():
        begin_s = time.perf_counter()
        layout.decode(connection.execute(layout.question, (first, first + WINDOW - 1)).fetchall())
        times_s.append(time.perf_counter() - begin_s)
    connection.close()
    return write_us, path.stat().st_size / slots, 1000 * float(np.median(times_s))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--slots", type=int, default=72_000, help="an hour has 90,000")
    options = parser.parse_args()
    print(f"{options.slots} slots of {PEOPLE} people; a question is ten seconds of one of them")
    for layout in LAYOUTS:
        with tempfile.TemporaryDirectory() as folder:
            write_us, size, ask_ms = measure(layout, Path(folder) / "p.db", options.slots)
        print(
            f"{layout.name:<45} write {write_us:6.1f} us  keep {size:6.0f} bytes  "
            f"ask {ask_ms:6.2f} ms"
        )


if __name__ == "__main__":
    main()
