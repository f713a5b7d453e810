"""Query a store: poses by time, track, joint, site and run."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    Engine,
    Select,
    Table,
    func,
    inspect,
    null,
    select,
)

from e3pose.base.errors import InputError
from e3pose.energy.saving import Saving
from e3pose.store import overview, schema
from e3pose.store.answers import StoredPoses, StoredRun, joined, plain_row, stored_poses, stored_run
from e3pose.store.database import database_url, reading, shown
from e3pose.store.times import When, as_when

Time = str | datetime | int | None  # as in `times.as_when`; None is without a bound

CHUNK_POSES = 10_000
MAX_POSES = 2_000_000  # at once in memory: a gigabyte; whoever wants more reads it in chunks
TABLES = ("slots", "tracks", "energy", "events", "zones", "summaries")
FOREVER = (-(2**63), 2**63 - 1)


@dataclass(frozen=True, slots=True)
class Span:
    """The rows of one run between two times, both ends included."""

    stored: StoredRun
    start_ns: int
    end_ns: int


class Store:
    """A store to query; each query opens it and sees the committed rows."""

    def __init__(self, store: str | Path) -> None:
        """Name the store: a path, or the URL of a database."""
        self.where = shown(database_url(store))
        self.place = store
        self._engines: dict[str, Engine] = {}  # making SQL takes longer than asking: one keeps it

    def runs(self) -> list[StoredRun]:
        """Return the runs, oldest first.

        Raises:
            InputError: when there is no store, or one that cannot be read.
        """
        with reading(self.place, self._engines) as connection:
            return self._runs(connection)

    def query(
        self,
        start: Time = None,
        end: Time = None,
        *,
        track: int | None = None,
        joint: str | None = None,
        site: str | None = None,
        run: int | None = None,
    ) -> StoredPoses:
        """Return poses between two times, both included.

        Args:
            start: such as `-10min`, `2026-11-21T14:00`, seconds of the run, a `datetime`, or
                nanoseconds since 1970; None for all from the beginning.
            end: likewise; None for all until now.
            track: one person only.
            joint: one joint only; the joint axis has then length 1.
            site: runs of one site only.
            run: one run only; times in seconds are of the newest run unless one is named.

        Raises:
            InputError: when a time, joint, run or site is unknown, the runs have different
                skeletons, or more was found than fits into memory.
        """
        chunks, found = [], 0
        for chunk in self.read(start, end, track=track, joint=joint, site=site, run=run):
            chunks.append(chunk)
            found += len(chunk)
            if found > MAX_POSES:
                raise InputError(
                    f"{self.where}: found more than {MAX_POSES} poses, expected fewer: "
                    "name a shorter time or one track, or read them in chunks"
                )
        return joined(chunks)

    def read(
        self,
        start: Time = None,
        end: Time = None,
        *,
        track: int | None = None,
        joint: str | None = None,
        site: str | None = None,
        run: int | None = None,
        after: tuple[int, int] | None = None,
        chunk: int = CHUNK_POSES,
    ) -> Iterator[StoredPoses]:
        """Yield the result of `query` in chunks, at least one, so that a day fits into memory.

        Args:
            start: as in `query`, and so are the others that are not here.
            after: run and slot: only what comes after that slot.
            chunk: rows in each.
        """
        with reading(self.place, self._engines) as connection:
            spans = self._spans(connection, start, end, site, run)
            joints = self._joints(connection, spans, joint, track)
            yield stored_poses([], joints, len(joints), None, self.where)
            for span in spans:
                if after is not None and span.stored.run_id < after[0]:
                    continue
                begin = after[1] + 1 if after and span.stored.run_id == after[0] else None
                column = None if joint is None else span.stored.run.joints.index(joint)
                count = len(span.stored.run.joints)
                # Closed before the connection is, whatever is wrong with the rows.
                with closing(self._pose_rows(connection, span, track, begin, chunk)) as found:
                    for rows in found:
                        yield stored_poses(rows, joints, count, column, self.where)

    def rows(
        self,
        table: str,
        start: Time = None,
        end: Time = None,
        *,
        site: str | None = None,
        run: int | None = None,
        offset: int = 0,
        limit: int | None = None,
    ) -> list[dict[str, Any]]:
        """Return rows of a table of `TABLES` between two times, by column name.

        A slot's `occlusion`, `deficit` and `energy_j` are lists with one number per camera.

        Args:
            table: which.
            start: as in `query`, and so are the others that are not here.
            offset: rows to leave out at the beginning.
            limit: the most to return.
        """
        if table not in TABLES:
            raise InputError("table", repr(table[:40]), f"one of {', '.join(TABLES)}")
        found: list[dict[str, Any]] = []
        with reading(self.place, self._engines) as connection:
            spans = self._spans(connection, start, end, site, run)
            if not inspect(connection).has_table(table):
                return []  # a store of an earlier version
            columns = columns_of(connection, schema.ROWS[table])
            for span in spans:
                asked = _of_table(table, span, columns)
                if offset:
                    count = connection.scalar(select(func.count()).select_from(asked.subquery()))
                    if (count or 0) <= offset:
                        offset -= count or 0
                        continue
                if limit is not None:
                    asked = asked.limit(limit - len(found))
                if offset:
                    asked, offset = asked.offset(offset), 0
                for row in connection.execute(asked).mappings():
                    if len(found) >= MAX_POSES:
                        raise InputError(
                            f"{self.where}: found more than {MAX_POSES} rows, expected fewer: "
                            "name a shorter time"
                        )
                    found.append(plain_row(dict(row), len(span.stored.run.cameras), self.where))
        return found

    def coverage(self, start_ns: int, end_ns: int, parts: int) -> tuple[list[int], list[int]]:
        """Return how many slots are stored and how many are blind, see `overview.coverage`."""
        with reading(self.place, self._engines) as connection:
            return overview.coverage(connection, start_ns, end_ns, parts)

    def spent(self, start_ns: int, end_ns: int) -> list[overview.Spent]:
        """Return the energy of each camera, see `overview.spent`."""
        with reading(self.place, self._engines) as connection:
            return overview.spent(connection, start_ns, end_ns)

    def saved(self, start_ns: int, end_ns: int, active_w: Mapping[str, float]) -> Saving | None:
        """Return the saving of whole cameras, see `overview.saved`."""
        with reading(self.place, self._engines) as connection:
            return overview.saved(connection, start_ns, end_ns, active_w, self.where)

    def stays(self, start_ns: int, end_ns: int) -> list[overview.StoredStay]:
        """Return the visits to zones, see `overview.stays`."""
        with reading(self.place, self._engines) as connection:
            return overview.stays(connection, start_ns, end_ns)

    def _runs(self, connection: Connection) -> list[StoredRun]:
        asked = select(*columns_of(connection, schema.runs)).order_by(schema.runs.c.run_id)
        rows = connection.execute(asked).all()
        return [stored_run(row, self.where) for row in rows]

    def _spans(
        self, connection: Connection, start: Time, end: Time, site: str | None, run: int | None
    ) -> list[Span]:
        stored = self._runs(connection)
        sites = sorted({one.run.site for one in stored})
        if site is not None and site not in sites:
            raise InputError("site", repr(site[:80]), _some(sites), self.where)
        ids = [one.run_id for one in stored]
        if run is not None and run not in ids:
            raise InputError("run", run, _some(ids), self.where)
        stored = [
            one for one in stored if site in (None, one.run.site) and run in (None, one.run_id)
        ]
        now = datetime.now().astimezone()
        first, last = (None if time is None else as_when(time, now) for time in (start, end))
        if any(when is not None and when.origin == "run" for when in (first, last)):
            stored = stored[-1:]
        spans = []
        for one in stored:
            low, high = _bounds(first, last, one.run.started_ns)
            if low > high:
                raise InputError("time", f"{start!r} to {end!r}", "the earlier one first")
            spans.append(Span(one, low, high))
        return spans

    def _joints(
        self, connection: Connection, spans: Sequence[Span], joint: str | None, track: int | None
    ) -> tuple[str, ...]:
        if joint is not None:
            for span in spans:
                if joint not in span.stored.run.joints:
                    known = ", ".join(span.stored.run.joints)
                    listed = f"one of run {span.stored.run_id}: {known}"
                    raise InputError("joint", repr(joint[:40]), listed)
            return (joint,)
        kinds = {span.stored.run.joints: span.stored for span in spans}
        if len(kinds) > 1:  # those with slots in the time, or with the track
            there = [span for span in spans if _slot_bounds(connection, span, track)]
            kinds = {span.stored.run.joints: span.stored for span in there or spans[:1]}
        if len(kinds) > 1:
            named = " and ".join(
                f"run {one.run_id} has {one.run.skeleton}" for one in list(kinds.values())[:2]
            )
            raise InputError(f"{self.where}: {named}, expected one skeleton: name one run or joint")
        return next(iter(kinds), ())

    def _pose_rows(
        self, connection: Connection, span: Span, track: int | None, begin: int | None, chunk: int
    ) -> Generator[Sequence[Any], None, None]:
        poses = schema.poses
        bounds = _slot_bounds(connection, span, track)
        if bounds is None:
            return
        if begin is not None:
            bounds = max(bounds[0], begin), bounds[1]
        # By the key, run and slot, with which the rows of a stretch of time lie together.
        asked = (
            select(*columns_of(connection, poses))
            .where(poses.c.run_id == span.stored.run_id)
            .where(poses.c.slot.between(*bounds))
            .where(poses.c.time_ns.between(span.start_ns, span.end_ns))
            .order_by(poses.c.slot, poses.c.track_id)
        )
        if track is not None:
            asked = asked.where(poses.c.track_id == track)
        with connection.execution_options(yield_per=chunk).execute(asked) as result:
            yield from result.partitions()


def _slot_bounds(connection: Connection, span: Span, track: int | None) -> tuple[int, int] | None:
    """Return the first and last slot that can hold an answer, None if none can."""
    run_id, slots, tracks = span.stored.run_id, schema.slots, schema.tracks
    first, last = FOREVER
    if track is not None:
        there = connection.execute(
            select(tracks).where(tracks.c.run_id == run_id, tracks.c.track_id == track)
        ).first()
        if there is None:
            return None
        first, last = there.first_slot, there.last_slot
    if (span.start_ns, span.end_ns) != FOREVER:
        # A wall clock that stepped back may put slots out of order: all that lie in the time count.
        # The sum hides the key's first column: the planner would walk the run and not the time.
        inside = select(func.min(slots.c.slot), func.max(slots.c.slot)).where(
            slots.c.time_ns.between(span.start_ns, span.end_ns), slots.c.run_id + 0 == run_id
        )
        low, high = connection.execute(inside).one()
        if low is None:
            return None
        first, last = max(first, low), min(last, high)
    return (first, last) if first <= last else None


def _bounds(first: When | None, last: When | None, started_ns: int) -> tuple[int, int]:
    return (
        FOREVER[0] if first is None else first.absolute(started_ns),
        FOREVER[1] if last is None else last.absolute(started_ns),
    )


def columns_of(connection: Connection, table: Table) -> list[ColumnElement[Any]]:
    """Return the columns of a table; null for columns that an earlier schema lacks."""
    there = {column["name"] for column in inspect(connection).get_columns(table.name)}
    return [each if each.name in there else null().label(each.name) for each in table.c]


def _of_table(table: str, span: Span, wanted: Sequence[ColumnElement[Any]]) -> Select[Any]:
    columns = schema.ROWS[table].c
    asked = select(*wanted).where(columns.run_id == span.stored.run_id)
    if table == "tracks":  # whoever was there at some time between
        asked = asked.where(columns.last_ns >= span.start_ns, columns.first_ns <= span.end_ns)
        return asked.order_by(columns.track_id)
    time = columns.time_ns
    return asked.where(time.between(span.start_ns, span.end_ns)).order_by(time)


def _some(values: Sequence[Any]) -> str:
    shown_values = ", ".join(str(value)[:40] for value in values[-8:])
    return f"one of {shown_values}" if values else "a store that holds a run"
