"""Create the tables of a store, and migrate earlier schemas.

A step is plain SQL of its time, not today's tables: it means the same when they have changed again.
All steps are one transaction: a store has its old version or the new one, never one between.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from sqlalchemy import Connection, insert, select, text, update

from e3pose.store import schema

LOCK = 0x6533706F  # of PostgreSQL: two programs that make or change tables do it in turn
ZONES_2 = """CREATE TABLE zones (
    run_id BIGINT NOT NULL,
    time_ns BIGINT NOT NULL,
    zone TEXT NOT NULL,
    track_id BIGINT NOT NULL,
    kind TEXT NOT NULL,
    slot BIGINT NOT NULL,
    count BIGINT NOT NULL,
    stayed_s FLOAT NOT NULL,
    PRIMARY KEY (run_id, time_ns, zone, track_id, kind)
)"""

SUMMARIES_6 = """CREATE TABLE summaries (
    run_id BIGINT NOT NULL,
    time_ns BIGINT NOT NULL,
    number BIGINT NOT NULL,
    version INTEGER NOT NULL,
    span_s FLOAT NOT NULL,
    software TEXT NOT NULL,
    slots BIGINT NOT NULL,
    views FLOAT,
    people FLOAT,
    most_people BIGINT NOT NULL,
    error_mm FLOAT,
    took_ms FLOAT,
    blind TEXT NOT NULL,
    zones TEXT NOT NULL,
    entered TEXT NOT NULL,
    states TEXT NOT NULL,
    events TEXT NOT NULL,
    joules TEXT NOT NULL,
    charge TEXT NOT NULL,
    faults TEXT NOT NULL,
    PRIMARY KEY (run_id, time_ns)
)"""
OUTBOXES_6 = """CREATE TABLE outboxes (
    site TEXT NOT NULL,
    begun_ns BIGINT NOT NULL,
    newest BIGINT NOT NULL,
    shed BIGINT NOT NULL,
    PRIMARY KEY (site)
)"""

FORGOTTEN_7 = """CREATE TABLE forgotten (
    number BIGINT NOT NULL,
    site TEXT NOT NULL,
    start_ns BIGINT NOT NULL,
    end_ns BIGINT NOT NULL,
    run_started_ns BIGINT,
    track_id BIGINT,
    PRIMARY KEY (number)
)"""
ARCHIVES_7 = """CREATE TABLE archives (
    site TEXT NOT NULL,
    place TEXT NOT NULL,
    forgotten BIGINT NOT NULL,
    PRIMARY KEY (site, place)
)"""

CLIPS_11 = """CREATE TABLE clips (
    number {number} NOT NULL,
    site TEXT NOT NULL,
    name TEXT NOT NULL,
    note TEXT NOT NULL,
    start_ns BIGINT NOT NULL,
    end_ns BIGINT NOT NULL,
    made_ns BIGINT NOT NULL,
    PRIMARY KEY (number)
)"""

HUBS_12 = """CREATE TABLE hubs (
    site TEXT NOT NULL,
    hub TEXT NOT NULL,
    taken BIGINT NOT NULL,
    asked_ns BIGINT NOT NULL,
    PRIMARY KEY (site, hub)
)"""


def prepare(connection: Connection, where: str) -> int:
    """Make the tables of an empty database, or migrate a store.

    Args:
        connection: in a transaction that nothing was asked in.
        where: the store, for messages.

    Returns:
        The version that was found; 0 for an empty database.

    Raises:
        InputError: when the database holds something else, or tables of a version not known here.
    """
    postgres = connection.dialect.name == "postgresql"
    if postgres:
        connection.execute(text(f"SELECT pg_advisory_xact_lock({LOCK})"))
    found = schema.check_version(connection, where, may_be_empty=True)
    if 0 < found < schema.VERSION:
        if postgres:
            connection.execute(text("SET LOCAL statement_timeout = 0"))
        else:  # Python's driver begins none for what changes tables
            connection.exec_driver_sql("BEGIN IMMEDIATE")
            found = schema.check_version(connection, where)  # another may have been faster
        for version in range(found + 1, schema.VERSION + 1):
            STEPS[version](connection)
        connection.execute(update(schema.about).values(version=schema.VERSION))
    schema.metadata.create_all(connection)
    if connection.execute(select(schema.about.c.version)).first() is None:
        connection.execute(insert(schema.about), {"version": schema.VERSION})
    return found


def _to_2(connection: Connection) -> None:
    """Take the time into the keys of slots and poses; make a table for zones."""
    for table, key in (("slots", "run_id, slot"), ("poses", "run_id, slot, track_id")):
        _extend_key(connection, table, key, "time_ns")
    ending = " WITHOUT ROWID" if connection.dialect.name == "sqlite" else ""
    connection.exec_driver_sql(ZONES_2 + ending)


def _extend_key(connection: Connection, table: str, key: str, column: str) -> None:
    """Add a column to the end of a table's key."""
    if connection.dialect.name == "postgresql":
        connection.exec_driver_sql(f"ALTER TABLE {table} DROP CONSTRAINT {table}_pkey")
        connection.exec_driver_sql(f"ALTER TABLE {table} ADD PRIMARY KEY ({key}, {column})")
        return
    # SQLite changes no key: the table is written anew, in its order, and its indexes with it.
    asked = "SELECT type, sql FROM sqlite_master WHERE tbl_name = ? AND sql IS NOT NULL"
    parts = connection.exec_driver_sql(asked, (table,)).all()
    (made,) = (sql for kind, sql in parts if kind == "table")
    made = re.sub(r"PRIMARY KEY \([^)]*\)", f"PRIMARY KEY ({key}, {column})", made)
    connection.exec_driver_sql(re.sub(rf"\b{table}\b", f"new_{table}", made, count=1))
    connection.exec_driver_sql(f"INSERT INTO new_{table} SELECT * FROM {table} ORDER BY {key}")
    connection.exec_driver_sql(f"DROP TABLE {table}")
    connection.exec_driver_sql(f"ALTER TABLE new_{table} RENAME TO {table}")
    for kind, sql in parts:
        if kind == "index":
            connection.exec_driver_sql(sql)


def _to_4(connection: Connection) -> None:
    """Add the dynamics of joints; unknown for existing poses."""
    kind = "BYTEA" if connection.dialect.name == "postgresql" else "BLOB"
    connection.exec_driver_sql(f"ALTER TABLE poses ADD COLUMN dynamics {kind}")


def _to_5(connection: Connection) -> None:
    """Add the columns of people's states."""
    for column, kind in (
        ("track_id", "BIGINT"), ("zone", "TEXT"), ("phase", "TEXT"), ("start_ns", "BIGINT"),
        ("score", "FLOAT"),
    ):  # fmt: skip
        connection.exec_driver_sql(f"ALTER TABLE events ADD COLUMN {column} {kind}")


def _to_6(connection: Connection) -> None:
    """Add the tables of the outbox."""
    ending = " WITHOUT ROWID" if connection.dialect.name == "sqlite" else ""
    connection.exec_driver_sql(SUMMARIES_6 + ending)
    connection.exec_driver_sql("CREATE INDEX summaries_by_number ON summaries (number)")
    connection.exec_driver_sql(OUTBOXES_6)


def _to_7(connection: Connection) -> None:
    """Add the tables of deletions and archives."""
    connection.exec_driver_sql(FORGOTTEN_7)
    connection.exec_driver_sql(ARCHIVES_7)


def _to_11(connection: Connection) -> None:
    """Make the table of clips."""
    number = "SERIAL" if connection.dialect.name == "postgresql" else "INTEGER"
    connection.exec_driver_sql(CLIPS_11.format(number=number))


def _by(statement: str) -> Callable[[Connection], object]:
    return lambda connection: connection.exec_driver_sql(statement)


STEPS: dict[int, Callable[[Connection], object]] = {
    2: _to_2,
    3: _by("ALTER TABLE slots ADD COLUMN blind TEXT"),  # its cause; unknown for existing slots
    4: _to_4,
    5: _to_5,
    6: _to_6,
    7: _to_7,
    8: _by("ALTER TABLE tracks ADD COLUMN name TEXT"),
    9: _by("ALTER TABLE tracks ADD COLUMN colour TEXT"),
    10: _by("ALTER TABLE forgotten ADD COLUMN outbox_number BIGINT"),  # none of earlier deletions
    11: _to_11,
    12: _by(HUBS_12),
    13: _by("ALTER TABLE runs ADD COLUMN own_skeleton TEXT"),  # till then points without limbs
}
