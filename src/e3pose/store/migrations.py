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
WORDS = {  # of a dialect, for what statements have in braces
    "sqlite": {"blob": "BLOB", "number": "INTEGER", "keyed": " WITHOUT ROWID"},
    "postgresql": {"blob": "BYTEA", "number": "SERIAL", "keyed": ""},
}
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
){keyed}"""

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
){keyed}"""
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
    _by(ZONES_2)(connection)


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


def _by(*statements: str) -> Callable[[Connection], object]:
    def step(connection: Connection) -> None:
        for statement in statements:
            connection.exec_driver_sql(statement.format(**WORDS[connection.dialect.name]))

    return step


STEPS: dict[int, Callable[[Connection], object]] = {
    2: _to_2,
    3: _by("ALTER TABLE slots ADD COLUMN blind TEXT"),  # its cause; unknown for existing slots
    4: _by("ALTER TABLE poses ADD COLUMN dynamics {blob}"),  # unknown for existing poses
    5: _by(*(
        f"ALTER TABLE events ADD COLUMN {column}" for column in
        ("track_id BIGINT", "zone TEXT", "phase TEXT", "start_ns BIGINT", "score FLOAT")
    )),
    6: _by(SUMMARIES_6, "CREATE INDEX summaries_by_number ON summaries (number)", OUTBOXES_6),
    7: _by(FORGOTTEN_7, ARCHIVES_7),
    8: _by("ALTER TABLE tracks ADD COLUMN name TEXT"),
    9: _by("ALTER TABLE tracks ADD COLUMN colour TEXT"),
    10: _by("ALTER TABLE forgotten ADD COLUMN outbox_number BIGINT"),  # none of earlier deletions
    11: _by(CLIPS_11),
    12: _by(HUBS_12),
    13: _by("ALTER TABLE runs ADD COLUMN own_skeleton TEXT"),  # till then points without limbs
}  # fmt: skip
