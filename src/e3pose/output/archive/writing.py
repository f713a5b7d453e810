"""Archive finished hours of a store, and apply deletions that were asked for meanwhile."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from sqlalchemy import Connection, Engine, func, insert, select, update

from e3pose.base.errors import InputError
from e3pose.model.take import Motion, Take, motions_of
from e3pose.output.archive.deleting import delete_there
from e3pose.output.archive.manifest import (
    Entry,
    Manifest,
    check_there,
    days_of,
    digest,
    mark,
    read_manifest,
    write_manifest,
)
from e3pose.output.archive.places import Place
from e3pose.output.exports.wide import write_people
from e3pose.store import Store, schema
from e3pose.store.answers import StoredRun
from e3pose.store.database import database_url, reading, shown
from e3pose.store.forgetting import DAY_NS, changing, day_of, requests
from e3pose.store.rows import NS

CLOSED_NS = 600 * NS  # after its end, when rows of an hour are in the store, from the spool too
LATE_NS = 2 * DAY_NS  # hours younger than this are looked at again for rows that came late

Say = Callable[[str], None]
HOUR_NS = 3600 * NS


@dataclass(frozen=True, slots=True)
class Written:
    """The result of a pass over a store.

    Attributes:
        hours: archived, with those that were archived again.
        rows: of people in them.
        bytes: of their files.
        removed: days that were too old.
        deleted: rows and days that were asked to be deleted and were still there.
        problems: days that were left out, for their manifest or files; a line each.
    """

    hours: int = 0
    rows: int = 0
    bytes: int = 0
    removed: int = 0
    deleted: int = 0
    problems: tuple[str, ...] = ()


def archive_store(
    store: str | Path,
    site: str | None,
    place: Place,
    now_ns: int,
    keep_s: float | None = None,
    say: Say = lambda line: None,
    new: bool = False,
) -> Written:
    """Archive closed hours that the archive lacks; a killed pass goes on the next time.

    Args:
        store: path or URL; it may be written meanwhile.
        site: of which; None for all that it has.
        place: where to.
        now_ns: the time.
        keep_s: days older than this are removed from the archive; None removes none.
        say: called with a line for each file.
        new: whether to begin anew where an archive was and is no more.

    Raises:
        InputError: when one of them cannot be used.
    """
    runs = [one for one in Store(store).runs() if site in (None, one.run.site)]
    sites = sorted({one.run.site for one in runs})
    if site is not None and site not in sites:
        wanted = f"one of {', '.join(sites)[:200]}" if sites else "a store that holds a run"
        raise InputError("site", repr(site[:80]), wanted, shown(database_url(store)))
    done, problems = Written(), dict[str, None]()
    for each in sites:
        mine = [one for one in runs if one.run.site == each]
        with changing(store) as engine:
            deleted = _apply(engine, each, place, problems, new)
            hours, rows, size = _archive_site(
                store, each, mine, place, now_ns, keep_s, say, problems
            )
            deleted += _apply(engine, each, place, problems)  # of what was asked for meanwhile
        oldest = None if keep_s is None else day_of(now_ns - round(keep_s * NS))
        removed = 0 if oldest is None else sum(_removed(place, each, oldest, problems))
        done = Written(
            done.hours + hours, done.rows + rows, done.bytes + size, done.removed + removed,
            done.deleted + deleted,
        )  # fmt: skip
    return replace(done, problems=tuple(problems))


def _apply(
    engine: Engine, site: str, place: Place, problems: dict[str, None], new: bool = False
) -> int:
    """Note the archive in the store before any pose goes there; apply later deletions to it."""
    table = schema.archives
    mine = (table.c.site == site) & (table.c.place == place.name)
    with engine.begin() as connection:
        applied = connection.scalar(select(table.c.forgotten).where(mine))
        if applied is not None and not new:
            check_there(place)
        mark(place)
        if applied is None:
            row = {"site": site, "place": place.name, "forgotten": 0}
            connection.execute(insert(table), row)
        pending = requests(connection, site, applied or 0)
    deleted, whole = 0, True
    for what in pending:
        rows, left_out = delete_there(place, what)
        deleted, whole = deleted + rows, whole and not left_out
        problems.update(dict.fromkeys(left_out))
        if whole:  # else this and all that follow are asked for again the next time
            with engine.begin() as connection:
                connection.execute(update(table).where(mine).values(forgotten=what.number))
    return deleted


def _archive_site(
    store: str | Path,
    site: str,
    runs: list[StoredRun],
    place: Place,
    now_ns: int,
    keep_s: float | None,
    say: Say,
    problems: dict[str, None],
) -> tuple[int, int, int]:
    with reading(store) as connection:
        span = span_of(connection, runs)
    if span is None:
        return 0, 0, 0
    begin_ns = span[0] if keep_s is None else max(span[0], now_ns - round(keep_s * NS))
    begin_ns -= begin_ns % DAY_NS
    end_ns = min(span[1] + HOUR_NS, now_ns - CLOSED_NS)
    opened, counts = Store(store), [0, 0, 0]
    for day_ns in range(begin_ns, end_ns, DAY_NS):
        day = day_of(day_ns)
        try:
            manifest = read_manifest(place, site, day) or Manifest(site, day)
        except InputError as error:
            problems[str(error)] = None
            continue
        if manifest.deleted:
            continue
        until_ns = min(day_ns + DAY_NS, end_ns - end_ns % HOUR_NS)
        with reading(store) as connection:
            open_hours = list(hours_between(connection, runs, day_ns, until_ns))
        for hour in open_hours:
            there = manifest.files.get(hour.name)
            young = now_ns - hour.begin_ns < LATE_NS
            if there is not None and not (young and hour.slots > there.slots):
                continue
            content, entry = file_of(opened, hour)
            if content:
                place.write(f"{manifest.folder}/{hour.name}", content)
            manifest = manifest.with_file(hour.name, entry)
            write_manifest(place, manifest)
            counts = [counts[0] + 1, counts[1] + entry.rows, counts[2] + entry.bytes]
            say(f"{day} {hour.of_day:02d}:00: {entry.rows} rows, {entry.bytes / 1e6:.1f} MB")
    return counts[0], counts[1], counts[2]


def _removed(place: Place, site: str, oldest: str, problems: dict[str, None]) -> Iterator[int]:
    """Remove days before one; yield 1 for each."""
    for _, day in days_of(place, site):
        if day < oldest:
            folder = Manifest(site, day).folder
            # What names the files goes last: whoever is killed in it goes on the next time.
            try:
                for name in sorted(place.names(folder), key=lambda n: n.endswith(".json")):
                    place.remove(name)
            except (InputError, OSError) as error:
                problems[str(error)] = None
            else:
                yield 1


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
        """The hour of the day."""
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
    about = Take(run.name, run.limbed, run.interval_s, (), run.started_ns)
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
