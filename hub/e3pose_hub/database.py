"""The database of a hub: summaries of all sites, and a cursor in the outbox of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import msgspec
from sqlalchemy import (
    BigInteger,
    Column,
    Connection,
    Engine,
    Float,
    Index,
    Integer,
    MetaData,
    Table,
    Text,
    delete,
    func,
    insert,
    inspect,
    select,
    update,
)

from e3pose.base.errors import InputError
from e3pose.store.database import (
    REFUSALS,
    check_place,
    database_path,
    database_url,
    refusal_of,
    shown,
    writing_engine,
)
from e3pose.store.query import Time
from e3pose.store.rows import NS
from e3pose.store.saver import new_rows
from e3pose.store.schema import SUMMARY_JSON, summary_columns
from e3pose.store.times import as_when
from e3pose.wire.site_messages import Tombstone
from e3pose_hub.records import Summary

metadata = MetaData()
HOUR_NS = 3600 * NS
HOUR_JSON = ("zones", "entered", "states", "events", "faults")

summaries = Table(
    "summaries",
    metadata,
    Column("site", Text, primary_key=True),
    Column("started_ns", BigInteger, primary_key=True, autoincrement=False),  # of the run
    Column("time_ns", BigInteger, primary_key=True, autoincrement=False),
    *summary_columns(),
    Index("summaries_by_time", "time_ns"),
    Index("summaries_of_site", "site", "time_ns"),
)

# Sums of an hour: questions about a month read sixty times less.
hours = Table(
    "hours",
    metadata,
    Column("site", Text, primary_key=True),
    Column("time_ns", BigInteger, primary_key=True, autoincrement=False),
    Column("span_s", Float, nullable=False),
    Column("slots", BigInteger, nullable=False),
    Column("blind", BigInteger, nullable=False),  # slots, whatever the cause
    Column("person_h", Float, nullable=False),
    Column("most_people", BigInteger, nullable=False),
    Column("error_mm", Float),
    Column("joules", Float, nullable=False),
    Column("measured_j", Float, nullable=False),  # of these, by meters
    *(Column(name, Text, nullable=False) for name in HOUR_JSON),
    Index("hours_by_time", "time_ns"),
)

sites = Table(
    "sites",
    metadata,
    Column("site", Text, primary_key=True),
    Column("begun_ns", BigInteger, nullable=False),  # of the outbox that the cursor is of
    Column("taken", BigInteger, nullable=False),  # the cursor: all up to this number are here
    Column("lost", BigInteger, nullable=False),  # shed or deleted at the site before they were here
    Column("heard_ns", BigInteger),
    Column("problem", Text, nullable=False),
)

# Deletions at sites, and how many summaries each took here.
forgotten = Table(
    "forgotten",
    metadata,
    Column("site", Text, primary_key=True),
    Column("begun_ns", BigInteger, primary_key=True, autoincrement=False),  # of the outbox
    Column("number", BigInteger, primary_key=True, autoincrement=False),  # in it
    Column("start_ns", BigInteger, nullable=False),
    Column("end_ns", BigInteger, nullable=False),
    Column("run_started_ns", BigInteger),
    Column("track_id", BigInteger),  # of a person; null for everything in that time
    Column("heard_ns", BigInteger, nullable=False),
    Column("deleted", BigInteger, nullable=False),  # summaries
)

# Who came to poses by the page of a site.
accesses = Table(
    "accesses",
    metadata,
    Column("number", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("time_ns", BigInteger, nullable=False),
    Column("who", Text, nullable=False),
    Column("site", Text, nullable=False),
    Column("what", Text, nullable=False),
    sqlite_autoincrement=True,
)

READABLE = {"summaries": summaries, "hours": hours, "sites": sites}
MOST_READ = 200_000  # rows; a year of the hours of 22 sites


@dataclass(frozen=True, slots=True)
class Cursor:
    """Position in the outbox of a site up to which the hub has its summaries.

    Attributes:
        begun_ns: when the outbox was begun, nanoseconds since 1970, UTC.
        taken: number of the last summary or deletion that was fetched.
        lost: summaries that the site no longer had.
    """

    begun_ns: int = 0
    taken: int = 0
    lost: int = 0


def open_hub(database: str, kept: int = 0) -> Engine:
    """Return the database of a hub, with its tables.

    Args:
        database: path or URL.
        kept: connections to a server that stay open between two uses; then dispose of it.

    Raises:
        InputError: when something else is there, or nothing answers.
    """
    url = database_url(database)
    check_place(url)
    engine = writing_engine(url, kept)
    try:
        with engine.begin() as connection:
            if engine.dialect.name == "postgresql":
                check_role(lambda sql: connection.exec_driver_sql(sql).first(), shown(url))
            there = set(inspect(connection).get_table_names())
            if (there and not {"summaries", "sites"} <= there) or "slots" in there:
                found = ", ".join(sorted(there)[:5])
                raise InputError(f"{shown(url)}: found tables {found}, expected those of a hub")
            metadata.create_all(connection)
    except REFUSALS as error:
        raise InputError(f"{shown(url)}: cannot be used ({refusal_of(error)})") from None
    return engine


# Rights by which a role does more on its server than a hub needs: by attribute, and by membership.
RIGHTS = {"rolsuper": "SUPERUSER", "rolcreaterole": "CREATEROLE", "rolreplication": "REPLICATION"}
MEMBERSHIPS = ("pg_write_server_files", "pg_read_server_files", "pg_execute_server_program")


def check_role(ask: Callable[[str], Any], where: str) -> None:
    """Raise `InputError` for a role of PostgreSQL that may do more than a hub needs.

    Args:
        ask: returns the row of a question.
        where: the database, for the error.
    """
    member = (f"pg_has_role(session_user, '{name}', 'MEMBER')" for name in MEMBERSHIPS)
    columns = ", ".join((*RIGHTS, *member))
    role, *found = ask(f"SELECT rolname, {columns} FROM pg_roles WHERE rolname = session_user")
    rights = [
        right for right, has in zip((*RIGHTS.values(), *MEMBERSHIPS), found, strict=True) if has
    ]
    if rights:
        raise InputError(
            f"{where}: found the role {role} with {', '.join(rights[:3])}, by which a question "
            "could read or write the server's files, expected a role that owns the hub's database "
            "alone: CREATE ROLE hub LOGIN PASSWORD '...'; ALTER DATABASE ... OWNER TO hub"
        )


def cursor_of(connection: Connection, site: str) -> Cursor:
    """Return the cursor of a site."""
    c = sites.c
    found = connection.execute(select(c.begun_ns, c.taken, c.lost).where(c.site == site)).first()
    return Cursor() if found is None else Cursor(*found)


def keep(
    engine: Engine,
    site: str,
    rows: Sequence[Summary],
    cursor: Cursor,
    heard_ns: int,
    deletions: Sequence[Tombstone] = (),
) -> None:
    """Store summaries and the cursor after them in one transaction; one that is there stays.

    Args:
        engine: of the hub's database.
        site: its name.
        rows: its summaries.
        cursor: after them.
        heard_ns: the time.
        deletions: at the site, repeated here; no summary of a deleted day comes back.
    """
    with engine.begin() as connection:
        for one in deletions:
            _forget(connection, site, one, cursor.begun_ns, heard_ns)
        rows = _without_forgotten(connection, site, rows)
        if rows:
            plain = [
                {
                    "site": site,
                    **{k: v for k, v in msgspec.structs.asdict(row).items() if k != "number"},
                }
                for row in rows
            ]
            for row in plain:
                row.update((name, msgspec.json.encode(row[name]).decode()) for name in SUMMARY_JSON)
            connection.execute(new_rows(connection.dialect.name, summaries), plain)
            sum_hours(connection, site, {hour_of(row.time_ns) for row in rows})
        new = {
            "begun_ns": cursor.begun_ns, "taken": cursor.taken, "lost": cursor.lost,
            "heard_ns": heard_ns, "problem": "",
        }  # fmt: skip
        _note(connection, site, new)


def _forget(
    connection: Connection, site: str, what: Tombstone, begun_ns: int, heard_ns: int
) -> None:
    """Delete what was deleted at a site; a person is in no summary."""
    deleted, c = 0, summaries.c
    if what.track_id is None:
        inside = c.site == site, c.time_ns >= what.start_ns, c.time_ns < what.end_ns
        deleted = connection.execute(delete(summaries).where(*inside)).rowcount
        h = hours.c
        spans = h.site == site, h.time_ns > what.start_ns - HOUR_NS, h.time_ns < what.end_ns
        sum_hours(connection, site, connection.scalars(select(h.time_ns).where(*spans)).all())
    row = {
        "site": site, "begun_ns": begun_ns, "number": what.number, "start_ns": what.start_ns,
        "end_ns": what.end_ns, "run_started_ns": what.run_started_ns, "track_id": what.track_id,
        "heard_ns": heard_ns, "deleted": deleted,
    }  # fmt: skip
    connection.execute(new_rows(connection.dialect.name, forgotten), row)


def _without_forgotten(connection: Connection, site: str, rows: Sequence[Summary]) -> list[Summary]:
    """Return rows less those of deleted days, which another outbox of the site may still have."""
    c = forgotten.c
    asked = select(c.start_ns, c.end_ns).where(c.site == site, c.track_id.is_(None))
    days = connection.execute(asked).all() if rows else []
    return [r for r in rows if not any(start <= r.time_ns < end for start, end in days)]


@dataclass(frozen=True, slots=True)
class Deletion:
    """A deletion at a site, and what is left of it here.

    Attributes:
        site: its name.
        start_ns, end_ns: the deleted time; the end is not included.
        track_id: the deleted person; None for everything in that time.
        run_started_ns: start of that person's run.
        heard_ns: when the hub was told.
        deleted: summaries that the hub deleted.
        left: summaries of that time at the hub; 0 for a person, who is in none.
    """

    site: str
    start_ns: int
    end_ns: int
    track_id: int | None
    run_started_ns: int | None
    heard_ns: int
    deleted: int
    left: int


def read_forgotten(database: str) -> list[Deletion]:
    """Return the deletions at sites, newest first, with the summaries that are left now."""
    c, s = forgotten.c, summaries.c
    left = (
        select(func.count())
        .where(s.site == c.site, s.time_ns >= c.start_ns, s.time_ns < c.end_ns)
        .where(c.track_id.is_(None))
        .scalar_subquery()
    )
    asked = select(
        c.site, c.start_ns, c.end_ns, c.track_id, c.run_started_ns, c.heard_ns, c.deleted, left
    ).order_by(c.heard_ns.desc(), c.number.desc())
    engine = open_hub(database)
    with closing(engine.connect()) as connection:
        return [Deletion(*row) for row in connection.execute(asked)]


def read_rows(
    database: str,
    table: str,
    site: str | None = None,
    start: Time = None,
    end: Time = None,
) -> tuple[list[str], list[Sequence[Any]]]:
    """Return the names of a table's columns and its rows, by site and time.

    Args:
        database: of a hub: path or URL.
        table: a key of `READABLE`.
        site: its name; None for all sites.
        start: of the time wanted, as text, a `datetime` or nanoseconds since 1970; `sites` has
            none.
        end: likewise; it is not included.

    Raises:
        InputError: for no hub, a time that is none, or more than `MOST_READ` rows.
    """
    url, found = database_url(database), READABLE[table]
    path, now = database_path(url), datetime.now().astimezone()
    if path is not None and not path.is_file():
        raise InputError(str(path), "no such file", "the database of a hub: e3pose hub run")
    asked = select(found).order_by(*found.primary_key).limit(MOST_READ + 1)
    if site is not None:
        asked = asked.where(found.c.site == site)
    for name, time in (("start", start), ("end", end)):
        if time is None:
            continue
        when = as_when(time, now)
        if when.origin == "run" or "time_ns" not in found.c:
            raise InputError(name, repr(time), "a time of summaries or hours such as 14:00 or -7d")
        c = found.c.time_ns
        asked = asked.where(c >= when.ns if name == "start" else c < when.ns)
    engine = open_hub(database)
    try:
        with closing(engine.connect()) as connection:
            rows: list[Sequence[Any]] = [*connection.execute(asked)]
    except REFUSALS as error:
        raise InputError(f"{shown(url)}: cannot be used ({refusal_of(error)})") from None
    if len(rows) > MOST_READ:
        raise InputError(table, f"more than {MOST_READ} rows", "one site, or a shorter time")
    return [column.name for column in found.c], rows


def note_problem(engine: Engine, site: str, problem: str) -> None:
    """Store why a site cannot be asked."""
    with engine.begin() as connection:
        _note(connection, site, {"problem": problem[:500]})


def hour_of(time_ns: int) -> int:
    """Return when the hour of a time begins."""
    return time_ns - time_ns % HOUR_NS


def sum_hours(connection: Connection, site: str, begins_ns: Collection[int]) -> None:
    """Sum up hours of a site anew, from the summaries that are there."""
    c, rows = summaries.c, list[dict[str, object]]()
    names = ("time_ns", "span_s", "slots", "people", "most_people", "error_mm", "blind", "joules")
    for begin_ns in begins_ns:
        inside = c.time_ns.between(begin_ns, begin_ns + HOUR_NS - 1)
        asked = select(*(c[name] for name in (*names, *HOUR_JSON))).where(c.site == site, inside)
        found = connection.execute(asked).all()
        if found:
            rows.append({"site": site, "time_ns": begin_ns, **_hour(found)})
    gone = hours.c.site == site, hours.c.time_ns.in_(list(begins_ns))
    connection.execute(delete(hours).where(*gone))
    if rows:
        connection.execute(insert(hours), rows)


def _hour(minutes: Sequence[Any]) -> dict[str, object]:
    """Return the sums of minutes."""
    totals = {name: Counter[str]() for name in HOUR_JSON}
    joules = measured_j = blind = person_s = seen_s = error_s = 0.0
    for minute in minutes:
        for name, total in totals.items():
            read = msgspec.json.decode(getattr(minute, name))
            total.update(read if isinstance(read, dict) else dict.fromkeys(read, 1))
        for spent in msgspec.json.decode(minute.joules).values():
            joules += sum(spent.values())
            measured_j += spent.get("measured", 0.0)
        blind += sum(msgspec.json.decode(minute.blind).values())
        person_s += (minute.people or 0.0) * minute.span_s
        if minute.error_mm is not None:
            seen_s += minute.span_s
            error_s += minute.error_mm * minute.span_s
    return {
        "span_s": sum(m.span_s for m in minutes), "slots": sum(m.slots for m in minutes),
        "blind": round(blind), "person_h": person_s / 3600,
        "most_people": max(m.most_people for m in minutes),
        "error_mm": error_s / seen_s if seen_s else None,
        "joules": joules, "measured_j": measured_j,
        **{name: msgspec.json.encode(total, order="sorted").decode()
           for name, total in totals.items()},
    }  # fmt: skip


def _note(connection: Connection, site: str, values: dict[str, object]) -> None:
    if not connection.execute(update(sites).where(sites.c.site == site).values(values)).rowcount:
        nothing = {"begun_ns": 0, "taken": 0, "lost": 0, "problem": ""}
        connection.execute(insert(sites), {"site": site, **nothing, **values})
