"""People of a store: their names, and all that it keeps of each.

A person is a name, with the tracks that have it, or a track without one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Table, func, select, text, tuple_, update

from e3pose.base.errors import InputError
from e3pose.store import schema
from e3pose.store.database import (
    REFUSALS,
    database_url,
    reading,
    reason_of,
    shown,
    writing_engine,
)
from e3pose.store.forgetting import Forgotten
from e3pose.store.migrations import prepare
from e3pose.store.query import Store, columns_of

Track = tuple[int, int]  # run and track
OF_PEOPLE = (schema.poses, schema.tracks, schema.events, schema.zones)  # tables with a track
MAX_NAME = 100
PATIENCE_MS = 60_000  # for what a running edge commits


@dataclass(frozen=True, slots=True)
class StoredPerson:
    """A person of a store.

    Attributes:
        name: None of somebody without one.
        tracks: runs and tracks, oldest first.
        first_ns, last_ns: when the person was there, nanoseconds since 1970.
    """

    name: str | None
    tracks: tuple[Track, ...]
    first_ns: int
    last_ns: int


def people_of(store: str | Path, site: str | None = None) -> list[StoredPerson]:
    """Return the people of a store, by when they were there first.

    Raises:
        InputError: when the store cannot be read.
    """
    with reading(store) as connection:
        tracks, runs = schema.tracks, schema.runs
        asked = select(*columns_of(connection, tracks)).order_by(tracks.c.first_ns)
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
        )
        for each in people.values()
    ]


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
    """Name tracks; return how many there were.

    Raises:
        InputError: for a name that is a number, empty or too long, or no such tracks.
    """
    if name is not None and (not name.strip() or len(name) > MAX_NAME or name.isdecimal()):
        wanted = f"1 to {MAX_NAME} characters, not only digits"
        raise InputError("name", repr(name[:40]), wanted)
    with _writing(store) as connection:
        changed = update(schema.tracks).where(_among(schema.tracks, tracks)).values(name=name)
        count = connection.execute(changed).rowcount
        if not count:
            raise InputError("track", _listed(tracks), "tracks of the store", str(store))
    return int(count)


def kept_of(store: str | Path, tracks: Sequence[Track]) -> dict[str, int]:
    """Return how many rows of each table are about tracks.

    Raises:
        InputError: when the store cannot be read.
    """
    with reading(store) as connection:
        return {table.name: _count(connection, table, tracks) for table in OF_PEOPLE}


def requests_of(store: str | Path, tracks: Sequence[Track]) -> list[Forgotten]:
    """Return what is to be deleted, for `store.forgetting` and `archive.deleting`.

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


def _count(connection: Connection, table: Table, tracks: Sequence[Track]) -> int:
    names = {column.name for column in columns_of(connection, table) if column.table is not None}
    if "track_id" not in names:  # a store of an earlier version
        return 0
    asked = select(func.count()).select_from(table).where(_among(table, tracks))
    return int(connection.scalar(asked) or 0)


def _listed(tracks: Sequence[Track]) -> str:
    return ", ".join(f"track {track} of run {run}" for run, track in tracks[:4])


@contextmanager
def _writing(store: str | Path) -> Iterator[Connection]:
    """Yield a connection in a transaction; the store is brought up to the present version."""
    url = database_url(store)
    with reading(store):  # refuses what is no store, and leaves it as it is
        pass
    engine = writing_engine(url)
    try:
        with engine.begin() as connection:
            prepare(connection, shown(url))
        with engine.begin() as connection:
            if connection.dialect.name == "sqlite":
                connection.exec_driver_sql(f"PRAGMA busy_timeout = {PATIENCE_MS}")
            else:
                connection.exec_driver_sql("SET LOCAL statement_timeout = 0")
            yield connection
    except REFUSALS as error:
        raise InputError(f"{shown(url)}: cannot be written ({reason_of(error)})") from None
    finally:
        engine.dispose()


def write_anew(store: str | Path) -> None:
    """Write the tables anew: what was deleted is then in no page of their files.

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
            f"({reason_of(error)}): run it again"
        ) from None
    finally:
        engine.dispose()
