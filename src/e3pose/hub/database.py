"""The database of a hub: summaries of all sites, and up to where each was asked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
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
    insert,
    inspect,
    select,
    update,
)

from e3pose.base.errors import InputError
from e3pose.hub.records import Summary
from e3pose.store.database import check_place, database_url, shown, writing_engine
from e3pose.store.delivery import new_rows
from e3pose.store.rows import NS
from e3pose.store.schema import SUMMARY_JSON, summary_columns

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

# Who came to poses: by a question about archives, or by the page of a site.
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


@dataclass(frozen=True, slots=True)
class Cursor:
    """Up to where a hub has the summaries of a site.

    Attributes:
        begun_ns: of the outbox.
        taken: number.
        lost: summaries that the site no longer had.
    """

    begun_ns: int = 0
    taken: int = 0
    lost: int = 0


def open_hub(database: str) -> Engine:
    """Return the database of a hub, with its tables.

    Raises:
        InputError: when something else is there.
    """
    url = database_url(database)
    check_place(url)
    engine = writing_engine(url)
    with engine.begin() as connection:
        there = set(inspect(connection).get_table_names())
        if (there and not {"summaries", "sites"} <= there) or "slots" in there:
            found = ", ".join(sorted(there))[:80]
            raise InputError(f"{shown(url)}: found tables {found}, expected those of a hub")
        metadata.create_all(connection)
    return engine


def cursor_of(connection: Connection, site: str) -> Cursor:
    """Return up to where the summaries of a site are here."""
    c = sites.c
    found = connection.execute(select(c.begun_ns, c.taken, c.lost).where(c.site == site)).first()
    return Cursor() if found is None else Cursor(*found)


def keep(engine: Engine, site: str, rows: Sequence[Summary], cursor: Cursor, heard_ns: int) -> None:
    """Store summaries and the cursor after them in one transaction; one that is there stays."""
    with engine.begin() as connection:
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
