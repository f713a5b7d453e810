"""Delete a day or a person from a store, and keep the request.

Who asked is not kept, nor what was deleted: only days, and numbers of people, so that what comes
late (a spool of a killed edge) or cannot be reached now (an archive) is deleted when it is there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, Table, delete, event, func, insert, select, text, update

from e3pose.base.errors import InputError
from e3pose.store import schema
from e3pose.store.database import REFUSALS, database_path, database_url, refusal_of, shown
from e3pose.store.database import writing_engine as engine_of
from e3pose.store.migrations import prepare
from e3pose.store.retention import forget_empty
from e3pose.store.rows import NS, Row
from e3pose.store.spool import LeftSpool, spools_of

BATCH_SLOTS = 2000  # of one transaction: the edge writes between two
TIMED = ("energy", "events", "zones", "summaries")
OF_PEOPLE = ("events", "zones")  # tables with rows of one person, beside `poses` and `tracks`
DAY_NS = 86_400 * NS


@dataclass(frozen=True, slots=True)
class Forgotten:
    """A deletion: a period of a site, or one person.

    Attributes:
        site: of which.
        start_ns: from when on, nanoseconds since 1970, UTC; of a person that of the run.
        end_ns: until when, not included.
        run_started_ns: of a person: which run, by its start; None for everything.
        track_id: the person.
        number: in the order in which it was asked for; 0 before it is stored.
        outbox_number: by which hubs hear of it; 0 where none could have anything of it.
    """

    site: str
    start_ns: int
    end_ns: int
    run_started_ns: int | None = None
    track_id: int | None = None
    number: int = 0
    outbox_number: int = 0

    @property
    def whole_day(self) -> bool:
        """Whether archives can delete it: a person or a whole day."""
        whole = self.start_ns % DAY_NS == 0 and self.end_ns - self.start_ns == DAY_NS
        return self.track_id is not None or whole

    @property
    def day(self) -> str:
        """The day that begins with it, as archives name it."""
        return day_of(self.start_ns)


def day_of(time_ns: int) -> str:
    """Return the day of a time, UTC, such as 2026-11-25."""
    moment = datetime(1970, 1, 1, tzinfo=timezone.utc) + timedelta(seconds=time_ns // NS)
    return moment.strftime("%Y-%m-%d")


def of_day(site: str, day: str) -> Forgotten:
    """Return the deletion of a day, UTC; raise `InputError` for an invalid day."""
    try:
        begun = datetime.strptime(day, "%Y-%m-%d").replace(tzinfo=timezone.utc)
    except ValueError:
        raise InputError("day", repr(day[:40]), "a day such as 2026-11-25") from None
    start_ns = round(begun.timestamp()) * NS
    return Forgotten(site, start_ns, start_ns + DAY_NS)


@contextmanager
def changing(store: str | Path) -> Iterator[Engine]:
    """Yield an engine that changes a store which a site may be writing.

    Raises:
        InputError: when there is no store, or one that cannot be written.
    """
    url = database_url(store)
    path, where = database_path(url), shown(url)
    if path is not None and not path.is_file():
        raise InputError(where, "no such file", "a store, which a running site writes")
    engine = engine_of(url)
    if path is not None:

        @event.listens_for(engine, "connect")
        def _set(connection: Any, _record: Any) -> None:
            connection.execute("PRAGMA secure_delete = ON")  # rows leave zeros

    try:
        with engine.begin() as connection:
            prepare(connection, where)
        yield engine
    except REFUSALS as error:
        raise InputError(f"{where}: cannot be written ({refusal_of(error)})") from None
    finally:
        engine.dispose()


def forget(store: str | Path, what: Forgotten) -> tuple[Forgotten, int]:
    """Delete from a store; return the deletion with its number, and the number of rows.

    The request is stored first: whoever is killed in the middle asks again and goes on.

    Raises:
        InputError: when a killed edge left rows that are not in the store yet, or the store
            cannot be written.
    """
    # Rows that a killed edge left may belong to the deletion.
    path = database_path(database_url(store))
    for spool in [] if path is None else spools_of(path):
        try:
            found = LeftSpool(spool)
        except (BlockingIOError, FileNotFoundError):
            continue
        found.close()
        raise InputError(
            f"{spool}: found rows of a killed edge that are not in the store, expected none: start "
            "the edge, which delivers them, and ask again"
        )
    with changing(store) as engine:
        with engine.begin() as connection:
            what = _noted(connection, what)
        deleted = sum(_deleted(engine, run_id, what) for run_id in _runs(engine, what))
        if engine.dialect.name == "sqlite":  # wipes what was deleted from the file and its log
            with engine.connect() as connection:
                connection.execute(text("PRAGMA wal_checkpoint(TRUNCATE)")).fetchall()
    return what, deleted


def left(store: str | Path, what: Forgotten) -> int:
    """Return how many rows of a deletion a store still has."""
    with changing(store) as engine, engine.connect() as connection:
        return sum(_count(connection, run_id, what) for run_id in _runs(engine, what))


def without_forgotten(
    connection: Connection, site: str, started_ns: int, rows: Sequence[Row]
) -> list[Row]:
    """Return late rows without deleted ones."""
    asked = requests(connection, site)
    return [row for row in rows if not any(_is_of(one, started_ns, row[1]) for one in asked)]


def requests(connection: Connection, site: str, after: int = 0) -> list[Forgotten]:
    """Return the deletions of a site after a number, in order."""
    table = schema.forgotten
    found = connection.execute(
        select(table).where(table.c.site == site, table.c.number > after).order_by(table.c.number)
    )
    return [
        Forgotten(
            r.site,
            r.start_ns,
            r.end_ns,
            r.run_started_ns,
            r.track_id,
            r.number,
            r.outbox_number or 0,
        )
        for r in found
    ]


def _is_of(what: Forgotten, started_ns: int, row: Mapping[str, Any]) -> bool:
    if what.track_id is not None:
        return bool(started_ns == what.run_started_ns and row.get("track_id") == what.track_id)
    return bool(what.start_ns <= row["time_ns"] < what.end_ns)


def _noted(connection: Connection, what: Forgotten) -> Forgotten:
    """Return a request with the number that it has, or gets."""
    for one in requests(connection, what.site):
        same = one.start_ns, one.end_ns, one.run_started_ns, one.track_id
        if same == (what.start_ns, what.end_ns, what.run_started_ns, what.track_id):
            return one
    table = schema.forgotten
    number = (connection.scalar(select(func.max(table.c.number))) or 0) + 1
    told = _outbox_number(connection, what.site)
    row = {
        "number": number, "site": what.site, "start_ns": what.start_ns, "end_ns": what.end_ns,
        "run_started_ns": what.run_started_ns, "track_id": what.track_id,
        "outbox_number": told,
    }  # fmt: skip
    connection.execute(insert(table), row)
    return replace(what, number=number, outbox_number=told or 0)


def _outbox_number(connection: Connection, site: str) -> int | None:
    """Take the next number of a site's outbox; None without an outbox."""
    boxes = schema.outboxes
    mine = boxes.c.site == site
    # Changed before it is read: the edge, which numbers summaries, waits for us.
    if not connection.execute(update(boxes).where(mine).values(newest=boxes.c.newest + 1)).rowcount:
        return None
    return connection.scalar(select(boxes.c.newest).where(mine))


def _runs(engine: Engine, what: Forgotten) -> list[int]:
    runs = schema.runs
    asked = select(runs.c.run_id).where(runs.c.site == what.site)
    if what.run_started_ns is not None:
        asked = asked.where(runs.c.started_ns == what.run_started_ns)
    with engine.connect() as connection:
        return list(connection.execute(asked).scalars())


def _of(table: Table, run_id: int, what: Forgotten) -> Any:
    """Return the condition for the rows of a table."""
    mine = table.c.run_id == run_id
    if what.track_id is not None:
        return mine & (table.c.track_id == what.track_id)
    return mine & (table.c.time_ns >= what.start_ns) & (table.c.time_ns < what.end_ns)


def _tables(what: Forgotten) -> list[Table]:
    names = ("slots", "poses", *TIMED) if what.track_id is None else ("poses", "tracks", *OF_PEOPLE)
    return [schema.ROWS[name] for name in names]


def _count(connection: Connection, run_id: int, what: Forgotten) -> int:
    count, (low, high) = 0, _slots(connection, run_id, what)
    for table in _tables(what):
        asked = select(func.count()).select_from(table).where(_of(table, run_id, what))
        if table.name == "poses":  # by its key, not all of the run
            asked = asked.where(table.c.slot.between(low, high))
        count += connection.scalar(asked) or 0
    return count


def _deleted(engine: Engine, run_id: int, what: Forgotten) -> int:
    """Delete the rows of a run, a few slots at a time; return how many."""
    count = 0
    with engine.connect() as connection:
        low, high = _slots(connection, run_id, what)
    whole = what.track_id is None
    for begin in range(low, high + 1, BATCH_SLOTS):
        with engine.begin() as connection:
            for table in (schema.poses, schema.slots) if whole else (schema.poses,):
                part = table.c.slot.between(begin, min(begin + BATCH_SLOTS - 1, high))
                statement = delete(table).where(_of(table, run_id, what), part)
                count += connection.execute(statement).rowcount
    with engine.begin() as connection:
        for table in _tables(what):
            if table.name not in ("poses", "slots"):
                statement = delete(table).where(_of(table, run_id, what))
                count += connection.execute(statement).rowcount
        if whole:
            _shorten_tracks(connection, run_id, low, high)
            forget_empty(connection, run_id)
    return count


def _slots(connection: Connection, run_id: int, what: Forgotten) -> tuple[int, int]:
    """Return the range of slots that may have rows; empty without any."""
    if what.track_id is not None:
        c = schema.tracks.c
        asked = select(c.first_slot, c.last_slot).where(_of(schema.tracks, run_id, what))
        track = connection.execute(asked).first()
        return (0, -1) if track is None else (track.first_slot, track.last_slot)
    ends = [_ends(connection, table, run_id) for table in (schema.slots, schema.poses)]
    known = [end for end in ends if end is not None]
    if not known:
        return 0, -1
    first, last = min(low for low, _ in known), max(high for _, high in known)
    return _beside(connection, run_id, what, first, last)


def _ends(connection: Connection, table: Table, run_id: int) -> tuple[int, int] | None:
    slot = table.c.slot
    asked = select(func.min(slot), func.max(slot)).where(table.c.run_id == run_id)
    low, high = connection.execute(asked).one()
    return None if low is None else (low, high)


def _beside(
    connection: Connection, run_id: int, what: Forgotten, first: int, last: int
) -> tuple[int, int]:
    """Return the slots of a run inside a period."""
    c = schema.slots.c
    mine = c.run_id == run_id
    times = [
        connection.scalar(select(c.time_ns).where(mine).order_by(order).limit(1))
        for order in (c.slot, c.slot.desc())
    ]
    if times[0] is not None and times[0] < what.start_ns:  # otherwise none is before
        before = select(c.slot).where(c.time_ns < what.start_ns, c.run_id + 0 == run_id)
        first = (connection.scalar(before.order_by(c.time_ns.desc()).limit(1)) or 0) + 1
    if times[1] is not None and times[1] >= what.end_ns:
        after = select(c.slot).where(c.time_ns >= what.end_ns, c.run_id + 0 == run_id)
        last = (connection.scalar(after.order_by(c.time_ns).limit(1)) or 0) - 1
    return first, last


def _shorten_tracks(connection: Connection, run_id: int, low: int, high: int) -> None:
    """Shorten tracks to their remaining slots."""
    tracks, poses = schema.tracks, schema.poses
    touched = tracks.c.run_id == run_id, tracks.c.first_slot <= high, tracks.c.last_slot >= low
    for track_id in connection.execute(select(tracks.c.track_id).where(*touched)).scalars().all():
        mine = tracks.c.run_id == run_id, tracks.c.track_id == track_id
        c = poses.c
        first, last, first_ns, last_ns = connection.execute(
            select(
                func.min(c.slot), func.max(c.slot), func.min(c.time_ns), func.max(c.time_ns)
            ).where(c.run_id == run_id, c.track_id == track_id)
        ).one()
        if first is None:
            connection.execute(delete(tracks).where(*mine))
        else:
            connection.execute(
                update(tracks)
                .where(*mine)
                .values(first_slot=first, last_slot=last, first_ns=first_ns, last_ns=last_ns)
            )
