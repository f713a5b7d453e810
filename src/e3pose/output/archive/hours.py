"""Closed hours of a store, and one of them as a file."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from sqlalchemy import Connection, func, select

from e3pose.model.skeleton import skeleton_of_joints
from e3pose.model.take import Motion, Take, motions_of
from e3pose.output.archive.manifest import Entry, digest
from e3pose.output.exports.wide import write_people
from e3pose.store import Store, schema
from e3pose.store.answers import StoredRun
from e3pose.store.rows import NS

HOUR_NS = 3600 * NS


@dataclass(frozen=True, slots=True)
class Hour:
    """An hour of a run.

    Attributes:
        stored: the run.
        begin_ns: of the hour, nanoseconds since 1970, UTC.
        slots: that the store has of it.
    """

    stored: StoredRun
    begin_ns: int
    slots: int

    @property
    def name(self) -> str:
        """Its file in the folder of the day."""
        return f"{self.of_day:02d}-{self.stored.run.started_ns}.parquet"

    @property
    def of_day(self) -> int:
        """Which hour of the day."""
        return self.begin_ns // HOUR_NS % 24


def hours_between(
    connection: Connection, runs: list[StoredRun], start_ns: int, end_ns: int
) -> Iterator[Hour]:
    """Yield the hours of some runs that have slots, oldest first.

    Args:
        connection: to the store.
        runs: of one site.
        start_ns: beginning of the first hour.
        end_ns: end of the last.
    """
    known = {one.run_id: one for one in runs}
    c = schema.slots.c
    for begin_ns in range(start_ns, end_ns, HOUR_NS):
        inside = c.time_ns.between(begin_ns, begin_ns + HOUR_NS - 1)
        counted = select(c.run_id, func.count()).where(inside).group_by(c.run_id)
        for run_id, slots in connection.execute(counted.order_by(c.run_id)).all():
            if run_id in known:
                yield Hour(known[run_id], begin_ns, slots)


def span_of(connection: Connection, runs: list[StoredRun]) -> tuple[int, int] | None:
    """Return the times of the oldest and newest slot of some runs; None without any."""
    c, spans = schema.slots.c, list[int]()
    for one in runs:  # by the key: the first and last slot of each
        for order in (c.slot, c.slot.desc()):
            asked = select(c.time_ns).where(c.run_id == one.run_id).order_by(order).limit(1)
            found = connection.scalar(asked)
            spans += [] if found is None else [found]
    return (min(spans), max(spans)) if spans else None


def file_of(store: Store, hour: Hour) -> tuple[bytes, Entry]:
    """Return an hour as a wide Parquet file, empty where nobody was there, and its entry."""
    run = hour.stored.run
    skeleton = skeleton_of_joints(run.joints, run.skeleton)
    about = Take(run.name, skeleton, run.interval_s, (), run.started_ns)
    tracks = list[int]()
    with tempfile.TemporaryDirectory(prefix="e3pose-archive-") as folder:
        path = Path(folder) / hour.name
        rows = write_people(about, _people(store, hour, tracks), path)
        content = path.read_bytes() if rows else b""
    entry = Entry(hour.of_day, run.name, run.started_ns, hour.slots, rows)
    if not rows:
        return b"", entry
    return content, Entry(
        entry.hour, entry.run, entry.started_ns, entry.slots, rows, tuple(tracks), len(content),
        digest(content), run.interval_s, run.skeleton,
    )  # fmt: skip


def _people(store: Store, hour: Hour, tracks: list[int]) -> Iterator[Motion]:
    """Yield everybody of an hour, one after the other, and note who it was."""
    run_id, begin_ns, end_ns = hour.stored.run_id, hour.begin_ns, hour.begin_ns + HOUR_NS - 1
    for row in store.rows("tracks", begin_ns, end_ns, run=run_id):
        track = int(row["track_id"])
        found = store.query(begin_ns, end_ns, track=track, run=run_id)
        slots, first = np.unique(found.slots, return_index=True)  # a clock set back stores two
        if not len(slots):
            continue
        tracks.append(track)
        yield from motions_of(slots, found.people[first])
