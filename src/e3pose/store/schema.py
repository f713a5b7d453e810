"""The schema of a store: tables, version, SQLite pragmas.

One row per person and slot, joints as a blob of float32: measured against rows per joint and blobs
per slot in `docs/decisions/0002-store-layout.md`.
"""

from __future__ import annotations

from typing import Any

from sqlalchemy import (
    BigInteger,
    Column,
    Connection,
    Float,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    Table,
    Text,
    UniqueConstraint,
    inspect,
    select,
)

from e3pose.base.errors import InputError

VERSION = 13  # one more with every change, and a step to it in `store.migrations`
# Columns keep name and meaning; earlier versions have fewer.
READABLE = tuple(range(1, VERSION + 1))

metadata = MetaData()

about = Table("e3pose_store", metadata, Column("version", Integer, nullable=False))

# A run is one life of a pipeline at one site: track ids and slots are unique within it.
runs = Table(
    "runs",
    metadata,
    Column("run_id", Integer, primary_key=True),
    Column("site", Text, nullable=False),
    Column("name", Text, nullable=False),
    Column("started_ns", BigInteger, nullable=False),
    Column("interval_ns", BigInteger, nullable=False),
    Column("skeleton", Text, nullable=False),
    Column("joints", Text, nullable=False),  # JSON list of names, in axis order
    Column("cameras", Text, nullable=False),  # JSON list of camera ids, in axis order
    Column("software", Text, nullable=False),
    Column("own_skeleton", Text),  # the file of a user's own as JSON; null for a shipped one
    UniqueConstraint("site", "started_ns"),
    sqlite_autoincrement=True,  # the id of a run that retention removed is never given again
)


def _in_run(*key: str) -> tuple[Column[int], ...]:
    return tuple(
        Column(name, BigInteger, primary_key=True, autoincrement=False) for name in ("run_id", *key)
    )


# Tables that grow have the time in their key: TimescaleDB and PostgreSQL partition by a column that
# every unique key holds.
slots = Table(
    "slots",
    metadata,
    *_in_run("slot", "time_ns"),
    Column("selected", Text, nullable=False),  # one 0 or 1 per camera
    Column("arrived", Text, nullable=False),
    Column("next_selection", Text, nullable=False),
    Column("occlusion", LargeBinary, nullable=False),  # (num_cameras,) float32
    Column("deficit", LargeBinary, nullable=False),  # (num_cameras,) float32
    Column("energy_j", LargeBinary),  # (num_cameras,) float32 joules charged for the slot
    Column("took_s", Float, nullable=False),
    Column("blind", Text),  # why no view arrived although one was due; empty: not blind
    Index("slots_by_time", "time_ns"),
    sqlite_with_rowid=False,
)

poses = Table(
    "poses",
    metadata,
    *_in_run("slot", "track_id", "time_ns"),
    Column("joints_m", LargeBinary, nullable=False),  # (num_joints, 3) float32, NaN where missing
    Column("scores", LargeBinary, nullable=False),  # (num_joints,) float16, 0 where missing
    Column("sigma_m", LargeBinary),  # (num_joints,) float16 standard deviation, where one is known
    Column("measured", LargeBinary, nullable=False),  # a bit per joint: seen in this slot itself
    Column("dynamics", LargeBinary),  # (num_joints, 9) bytes of `model.dynamics`, where known
    sqlite_with_rowid=False,
)

# When somebody was there: a question about one person reads that stretch, not the whole day.
tracks = Table(
    "tracks",
    metadata,
    *_in_run("track_id"),
    Column("first_slot", BigInteger, nullable=False),
    Column("last_slot", BigInteger, nullable=False),
    Column("first_ns", BigInteger, nullable=False),
    Column("last_ns", BigInteger, nullable=False),
    Column("name", Text),  # of the person; tracks of one name are one person
    Column("colour", Text),  # that the person is drawn in; of `people.COLOURS`
    sqlite_with_rowid=False,
)

# What a camera's meter said, heartbeat by heartbeat.
energy = Table(
    "energy",
    metadata,
    *_in_run("time_ns"),
    Column("camera_id", Text, primary_key=True),
    Column("energy_j", Float, nullable=False),
    Column("span_s", Float, nullable=False),
    Column("charge", Float),  # of the battery, [0, 1]
    Column("source", Text, nullable=False),  # measured or modelled, and how
    sqlite_with_rowid=False,
)

events = Table(
    "events",
    metadata,
    *_in_run("time_ns"),
    Column("number", BigInteger, primary_key=True, autoincrement=False),
    Column("kind", Text, nullable=False),
    Column("camera_id", Text),
    Column("message", Text, nullable=False),
    # Of what people do, where it is that:
    Column("track_id", BigInteger),  # -1: nobody's
    Column("zone", Text),
    Column("phase", Text),  # begun or ended
    Column("start_ns", BigInteger),
    Column("score", Float),  # probability that it is so
    sqlite_with_rowid=False,
)

# Who entered, stayed in or left which zone of the floor.
zones = Table(
    "zones",
    metadata,
    *_in_run("time_ns"),
    Column("zone", Text, primary_key=True),
    Column("track_id", BigInteger, primary_key=True, autoincrement=False),
    Column("kind", Text, primary_key=True),  # enter, dwell or leave
    Column("slot", BigInteger, nullable=False),
    Column("count", BigInteger, nullable=False),  # people in the zone from then on
    Column("stayed_s", Float, nullable=False),
    sqlite_with_rowid=False,
)

SUMMARY_MAPS = ("blind", "zones", "entered", "states", "events", "joules", "charge")
SUMMARY_JSON = (*SUMMARY_MAPS, "faults")  # objects, and a list


def summary_columns() -> list[Column[Any]]:
    """Return the columns of a minute's summary, at a site and at a hub."""
    return [
        Column("version", Integer, nullable=False),  # of the record, not of the schema
        Column("span_s", Float, nullable=False),
        Column("software", Text, nullable=False),
        Column("slots", BigInteger, nullable=False),
        Column("views", Float),
        Column("people", Float),
        Column("most_people", BigInteger, nullable=False),
        Column("error_mm", Float),
        Column("took_ms", Float),
        *(Column(name, Text, nullable=False) for name in SUMMARY_JSON),
    ]


# What may leave a site, a minute at a time: `store.summaries` has what the columns mean.
summaries = Table(
    "summaries",
    metadata,
    *_in_run("time_ns"),
    Column("number", BigInteger, nullable=False),  # the cursor: one more than that before, per site
    *summary_columns(),
    Index("summaries_by_number", "number"),
    sqlite_with_rowid=False,
)  # fmt: skip

# The cursor of each site, which must not run backwards when its summaries are gone.
outboxes = Table(
    "outboxes",
    metadata,
    Column("site", Text, primary_key=True),
    Column("begun_ns", BigInteger, nullable=False),  # tells this outbox from another of the site
    Column("newest", BigInteger, nullable=False),
    Column("shed", BigInteger, nullable=False),  # summaries up to this number had to make room
)

# What somebody asked to delete, days and people: `store.forgetting`.
forgotten = Table(
    "forgotten",
    metadata,
    Column("number", BigInteger, primary_key=True, autoincrement=False),
    Column("site", Text, nullable=False),
    Column("start_ns", BigInteger, nullable=False),
    Column("end_ns", BigInteger, nullable=False),
    Column("run_started_ns", BigInteger),
    Column("track_id", BigInteger),  # of a person; null for everything in that time
    Column("outbox_number", BigInteger),  # by which hubs hear of it; null where none could
)

# Stretches that somebody marked: `store.clips`.
clips = Table(
    "clips",
    metadata,
    Column("number", Integer, primary_key=True),
    Column("site", Text, nullable=False),
    Column("name", Text, nullable=False),
    Column("note", Text, nullable=False),
    Column("start_ns", BigInteger, nullable=False),
    Column("end_ns", BigInteger, nullable=False),
    Column("made_ns", BigInteger, nullable=False),
)

# Where poses of a site went, and up to which number of `forgotten` they were deleted there.
archives = Table(
    "archives",
    metadata,
    Column("site", Text, primary_key=True),
    Column("place", Text, primary_key=True),
    Column("forgotten", BigInteger, nullable=False),
)

# Up to which number each hub has the outbox, deletions included: `store.acknowledgements`.
hubs = Table(
    "hubs",
    metadata,
    Column("site", Text, primary_key=True),
    Column("hub", Text, primary_key=True),
    Column("taken", BigInteger, nullable=False),
    Column("asked_ns", BigInteger, nullable=False),
)

ROWS = {table.name: table for table in (slots, poses, tracks, energy, events, zones, summaries)}

# Full synchronous costs one fsync a commit, once in a while: what was acknowledged then survives a
# power cut, not only a killed process.
NEW_PRAGMA = "PRAGMA auto_vacuum = INCREMENTAL"  # before the first table: room can be given back
WRITER_PRAGMAS = (
    "PRAGMA journal_mode = WAL",
    "PRAGMA synchronous = FULL",
    "PRAGMA busy_timeout = 5000",
    "PRAGMA journal_size_limit = 67108864",
    "PRAGMA temp_store = MEMORY",
)


def check_version(connection: Connection, where: str, may_be_empty: bool = False) -> int:
    """Return the version of the store that a database holds; 0 of an empty one.

    Raises:
        InputError: when the database holds something else, or tables of a version not known here.
    """
    names = set(inspect(connection).get_table_names())
    if not names and may_be_empty:
        return 0
    if about.name not in names:
        found = f"tables {', '.join(sorted(names))[:80]}" if names else "no tables"
        raise InputError(f"{where}: found {found}, expected a database that e3pose writes")
    version = connection.execute(select(about.c.version)).scalar()
    if version is None and may_be_empty:  # killed between its tables and its version
        return 0
    if version not in READABLE:
        known = f"{READABLE[0]} to {READABLE[-1]}"
        raise InputError(
            f"{where}: schema version: found {version}, expected {known}; read it with the "
            "version of e3pose that wrote it, or let this one write to a new file"
        )
    return int(version)


def run_id_of(connection: Connection, site: str, started_ns: int) -> int | None:
    """Return the number of the run of a site that began then; None where the store lacks it."""
    mine = select(runs.c.run_id).where(runs.c.site == site, runs.c.started_ns == started_ns)
    found: int | None = connection.scalar(mine)
    return found
