"""People of a store: their names, and all that it keeps of each.

A person is a name, with the tracks that have it, or a track without one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from sqlalchemy import Connection, Engine, Table, func, inspect, select, text, tuple_, update

from e3pose.base.errors import InputError
from e3pose.store import schema
from e3pose.store.database import (
    REFUSALS,
    database_url,
    reading,
    refusal_of,
    shown,
    writing_engine,
)
from e3pose.store.forgetting import Forgotten, changing
from e3pose.store.query import Store, columns_of

Track = tuple[int, int]  # run and track
LATELY_NS = 60_000_000_000
OF_PEOPLE = (schema.poses, schema.tracks, schema.events, schema.zones)  # tables with a track
MAX_NAME = 100
# In the order of the scene's palette, which draws a track without one by its number.
COLOURS = ("blue", "orange", "green", "pink", "sky", "gold", "grey", "brown")
PATIENCE_MS = 60_000  # for what a running edge commits


@dataclass(frozen=True, slots=True)
class StoredPerson:
    """A person of a store.

    Attributes:
        name: None of somebody without one.
        tracks: runs and tracks, oldest first.
        first_ns, last_ns: when the person was there, nanoseconds since 1970.
        colour: of `COLOURS`; None where nobody chose one.
        spans: the same of each track.
    """

    name: str | None
    tracks: tuple[Track, ...]
    first_ns: int
    last_ns: int
    colour: str | None = None
    spans: tuple[tuple[int, int], ...] = ()


def people_of(
    store: str | Path, site: str | None = None, named: bool = False
) -> list[StoredPerson]:
    """Return the people of a store, by when they were there first.

    Args:
        store: path or URL.
        site: whose people; None for those of all sites.
        named: only those who have a name.

    Raises:
        InputError: when the store cannot be read.
    """
    with reading(store) as connection:
        tracks, runs = schema.tracks, schema.runs
        columns = columns_of(connection, tracks)
        asked = select(*columns).order_by(tracks.c.first_ns)
        if named:
            (name,) = (column for column in columns if column.name == "name")
            asked = asked.where(name.is_not(None))
        if site is not None:
            mine = select(runs.c.run_id).where(runs.c.site == site)
            asked = asked.where(tracks.c.run_id.in_(mine))
        rows = connection.execute(asked).all()
    people: dict[Any, list[Any]] = {}
    for row in rows:
        people.setdefault(row.name or (row.run_id, row.track_id), []).append(row)
    return [
        StoredPerson(
            each[0].name,
            tuple((row.run_id, row.track_id) for row in each),
            min(row.first_ns for row in each),
            max(row.last_ns for row in each),
            next((row.colour for row in reversed(each) if row.colour), None),
            tuple((row.first_ns, row.last_ns) for row in each),
        )
        for each in people.values()
    ]


class Called(NamedTuple):
    """The name and colour of a track."""

    name: str | None
    colour: str | None


def names_of(
    store: str | Path,
    site: str,
    started_ns: int | None,
    engines: dict[str, Engine] | None = None,
) -> tuple[int | None, dict[int, Called], dict[int, int]]:
    """Return a run, its tracks that have a name or a colour, and since when somebody is there.

    Args:
        store: path or URL.
        site: of the run.
        started_ns: when it began; None for the newest.
        engines: see `database.reading`.

    Returns:
        The run's number, None where the store does not have it yet, what tracks are called, and
        when those that were there within `LATELY_NS` came, nanoseconds since 1970.

    Raises:
        InputError: when the store cannot be read.
    """
    runs = schema.runs.c
    with reading(store, engines) as connection:
        if started_ns is None:
            run = connection.scalar(select(func.max(runs.run_id)).where(runs.site == site))
        else:
            run = schema.run_id_of(connection, site, started_ns)
        columns = {column.name: column for column in columns_of(connection, schema.tracks)}
        name, colour = columns["name"], columns["colour"]
        c = schema.tracks.c
        newest = select(func.max(c.last_ns)).where(c.run_id == run).scalar_subquery()
        lately = c.last_ns >= newest - LATELY_NS
        found = connection.execute(
            select(c.track_id, name, colour, c.first_ns, lately)
            .where(c.run_id == run)
            .where(name.is_not(None) | colour.is_not(None) | lately)
        ).all()
        called = {row[0]: Called(row[1], row[2]) for row in found if row[1] or row[2]}
        return run, called, {row[0]: row[3] for row in found if row[4]}


def tracks_of(
    store: str | Path, who: str, site: str | None = None, run: int | None = None
) -> tuple[Track, ...]:
    """Return the tracks of a person.

    Args:
        store: path or URL.
        who: a name, or the number of a track.
        site: whose people; None for those of all sites.
        run: of the track; None for the newest.

    Raises:
        InputError: when the store has no such person.
    """
    people = people_of(store, site)
    for person in people:
        if person.name == who:
            return person.tracks
    if who.isdecimal():
        if run is None:
            run = max((each for person in people for each, _ in person.tracks), default=0)
        return ((run, int(who)),)
    names = [person.name for person in people if person.name]
    raise InputError("person", repr(who[:40]), f"a track, or one of {', '.join(names)}", str(store))


def set_name(store: str | Path, tracks: Sequence[Track], name: str | None) -> int:
    """Name tracks and give them the person's colour; return how many there are.

    Raises:
        InputError: for a name that is a number, empty or too long, or no such tracks.
    """
    good = name is None or (name.strip() and len(name) <= MAX_NAME and name.isprintable())
    if not good or (name is not None and name.isdecimal()):
        wanted = f"1 to {MAX_NAME} characters, not only digits"
        raise InputError("name", repr(name)[:40], wanted)
    c = schema.tracks.c
    values: dict[str, str | None] = {"name": name}
    with _writing(store) as connection:
        of_name = select(c.colour).where(c.name == name, c.colour.is_not(None))
        if name is not None and (colour := connection.scalar(of_name.limit(1))):
            values["colour"] = colour
        return _changed(connection, store, tracks, values)


def set_colour(store: str | Path, tracks: Sequence[Track], colour: str | None) -> int:
    """Set the colour of tracks, None for the default; return how many there are.

    Raises:
        InputError: for no colour of `COLOURS`, or no such tracks.
    """
    if colour is not None and colour not in COLOURS:
        raise InputError("colour", repr(colour[:40]), f"one of {', '.join(COLOURS)}")
    with _writing(store) as connection:
        return _changed(connection, store, tracks, {"colour": colour})


def kept_of(store: str | Path, tracks: Sequence[Track]) -> dict[str, int]:
    """Return how many rows of each table are about tracks.

    Raises:
        InputError: when the store cannot be read.
    """
    with reading(store) as connection:
        return {table.name: _count(connection, table, tracks) for table in OF_PEOPLE}


def requests_of(store: str | Path, tracks: Sequence[Track]) -> list[Forgotten]:
    """Return the deletions for `store.forgetting` and `archive.deleting`.

    Raises:
        InputError: for a run that the store does not have.
    """
    runs = {one.run_id: one.run for one in Store(store).runs()}
    for run, _ in tracks:
        if run not in runs:
            raise InputError("run", run, f"one of {', '.join(map(str, runs))[:200]}", str(store))
    asked = []
    for run, track_id in tracks:
        begun_ns = runs[run].started_ns
        asked.append(Forgotten(runs[run].site, begun_ns, begun_ns, begun_ns, track_id))
    return asked


def _among(table: Table, tracks: Sequence[Track]) -> Any:
    return tuple_(table.c.run_id, table.c.track_id).in_(list(tracks))


def _changed(
    connection: Connection,
    store: str | Path,
    tracks: Sequence[Track],
    values: Mapping[str, str | None],
) -> int:
    changed = update(schema.tracks).where(_among(schema.tracks, tracks)).values(**values)
    count = int(connection.execute(changed).rowcount)
    if not count:
        raise InputError("track", _listed(tracks), "tracks of the store", str(store))
    return count


def _count(connection: Connection, table: Table, tracks: Sequence[Track]) -> int:
    there = inspect(connection)
    columns = there.get_columns(table.name) if there.has_table(table.name) else ()
    if all(column["name"] != "track_id" for column in columns):  # a store of an earlier version
        return 0
    asked = select(func.count()).select_from(table).where(_among(table, tracks))
    return int(connection.scalar(asked) or 0)


def _listed(tracks: Sequence[Track]) -> str:
    return ", ".join(f"track {track} of run {run}" for run, track in tracks[:4])


@contextmanager
def _writing(store: str | Path) -> Iterator[Connection]:
    """Yield a connection in a transaction; the store is brought up to the present version."""
    with reading(store):  # refuses what is no store, and leaves it as it is
        pass
    with changing(store) as engine, engine.begin() as connection:
        if connection.dialect.name == "sqlite":
            connection.exec_driver_sql(f"PRAGMA busy_timeout = {PATIENCE_MS}")
        else:
            connection.exec_driver_sql("SET LOCAL statement_timeout = 0")
        yield connection


def write_anew(store: str | Path) -> None:
    """Rewrite the tables, so that no page of their files keeps deleted rows.

    For as long as that takes, a running edge keeps its slots in its spool.

    Raises:
        InputError: when that cannot be done.
    """
    url = database_url(store)
    engine = writing_engine(url).execution_options(isolation_level="AUTOCOMMIT")
    try:
        with engine.connect() as connection:
            if connection.dialect.name == "sqlite":
                connection.exec_driver_sql(f"PRAGMA busy_timeout = {PATIENCE_MS}")
                connection.exec_driver_sql("VACUUM")
                busy, *_ = connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)").one()
                if busy:
                    raise InputError(
                        f"{shown(url)}-wal: a program reads the store, expected none: what was "
                        "deleted stays in this file until they end; run it again"
                    )
                return
            connection.exec_driver_sql("SET statement_timeout = 0")
            connection.exec_driver_sql(f"SET lock_timeout = {PATIENCE_MS}")
            for table in OF_PEOPLE:
                connection.execute(text(f"VACUUM (FULL) {table.name}"))
    except REFUSALS as error:
        raise InputError(
            f"{shown(url)}: rows were deleted, but their pages not written anew "
            f"({refusal_of(error)}): run it again"
        ) from None
    finally:
        engine.dispose()
