"""The database of a hub: summaries of all sites, and up to where each was asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
from sqlalchemy import (
    BigInteger,
    Column,
    Connection,
    Engine,
    Index,
    MetaData,
    Table,
    Text,
    insert,
    inspect,
    select,
    update,
)

from e3pose.base.errors import InputError
from e3pose.hub.records import Summary
from e3pose.store.database import check_place, database_url, shown, writing_engine
from e3pose.store.delivery import new_rows
from e3pose.store.schema import SUMMARY_JSON, summary_columns

metadata = MetaData()

summaries = Table(
    "summaries",
    metadata,
    Column("site", Text, primary_key=True),
    Column("started_ns", BigInteger, primary_key=True, autoincrement=False),  # of the run
    Column("time_ns", BigInteger, primary_key=True, autoincrement=False),
    *summary_columns(),
    Index("summaries_by_time", "time_ns"),
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
        new = {
            "begun_ns": cursor.begun_ns, "taken": cursor.taken, "lost": cursor.lost,
            "heard_ns": heard_ns, "problem": "",
        }  # fmt: skip
        _note(connection, site, new)


def note_problem(engine: Engine, site: str, problem: str) -> None:
    """Store why a site cannot be asked."""
    with engine.begin() as connection:
        _note(connection, site, {"problem": problem[:500]})


def _note(connection: Connection, site: str, values: dict[str, object]) -> None:
    if not connection.execute(update(sites).where(sites.c.site == site).values(values)).rowcount:
        nothing = {"begun_ns": 0, "taken": 0, "lost": 0, "problem": ""}
        connection.execute(insert(sites), {"site": site, **nothing, **values})
