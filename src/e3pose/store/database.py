"""Open a store by path or URL, for its writer or for reading; quarantine damaged files."""

from __future__ import annotations

import os
import re
import shutil
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event, text
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, DataError, DBAPIError, IntegrityError, OperationalError
from sqlalchemy.pool import NullPool

from e3pose.base.errors import InputError, reason_of
from e3pose.base.installing import install_command
from e3pose.base.private import make_file
from e3pose.store import schema
from e3pose.store.migrations import prepare
from e3pose.store.postgres import (
    FORM,
    NAMES,
    OF_READERS,
    SESSION,
    engine_settings,
    set_deadlines,
    shown_url,
    with_driver,
)

MAGIC = b"SQLite format 3\0"
ENDINGS = (".db", ".sqlite", ".sqlite3")  # of files that may be taken for a damaged database
CHECKED_BYTES = 64 * 2**20  # larger databases would keep a start waiting for their whole check
# What SQLite says of a file whose content is wrong, in place of a disk or a lock that is.
CORRUPT, NOT_A_DATABASE = 11, 26  # its error codes
DAMAGE = ("malformed", "not a database")
# What a database says when it is used: the second to scripts, the third where it quotes what is
# damaged.
REFUSALS = (DBAPIError, sqlite3.Error, UnicodeDecodeError)


def database_url(store: str | Path) -> str:
    """Return the SQLAlchemy URL of a path, or the URL itself."""
    return store if isinstance(store, str) and "://" in store else f"sqlite:///{Path(store)}"


def database_path(url: str) -> Path | None:
    """Return the file of an SQLite URL, None for other databases.

    Raises:
        InputError: when the URL is none, or names a database of another kind or in memory.
    """
    try:
        parts = make_url(url)
    except (ArgumentError, ValueError):  # the second for a port that is no number
        shown = re.sub(r"//[^@/]*@", "//***@", url)[:200]  # not the password
        raise InputError(f"{shown}: expected a path or the URL of a database, {FORM}") from None
    kind = parts.get_backend_name()
    if kind in NAMES:
        return None
    if kind != "sqlite":
        raise InputError(shown_url(parts), kind, f"a file or {FORM}")
    if not parts.database or parts.database == ":memory:":
        raise InputError(f"{url}: found a database in memory, expected a file")
    return Path(parts.database)


def shown(url: str) -> str:
    """Return a store's name for messages: its path, or its URL without the password."""
    return str(database_path(url) or shown_url(make_url(url)))


def writing_engine(url: str, kept: int = 0) -> Engine:
    """Return an engine for writing; connects on first use.

    Args:
        url: of the database.
        kept: connections to a server that stay open between two uses: one costs the server as much
            as a hundred rows do.
    """
    engine = _engine(url, read_only=False, kept=kept)
    path = database_path(url)
    if path is not None:

        @event.listens_for(engine, "do_connect")
        def _make(*_: Any) -> None:
            make_file(path)  # its log and the index of that take over who may read it

        @event.listens_for(engine, "connect")
        def _set(connection: Any, _record: Any) -> None:
            if connection.execute("PRAGMA page_count").fetchone() == (0,):
                connection.execute(schema.NEW_PRAGMA)
            for pragma in schema.WRITER_PRAGMAS:
                connection.execute(pragma)

    return engine


@contextmanager
def reading(store: str | Path, engines: dict[str, Engine] | None = None) -> Iterator[Connection]:
    """Yield a connection that cannot write and never waits for the writer.

    Args:
        store: a path or URL.
        engines: where the engine, and with it the SQL of questions, is kept for the next time.

    Raises:
        InputError: when there is no store, or one that is damaged or of another version.
    """
    url = database_url(store)
    path = database_path(url)
    where = shown(url)
    if path is not None:
        if not path.is_file():
            found = "no plain file" if path.exists() else "no such file"
            wanted = "a store, which a running site writes, or e3pose replay --store"
            raise InputError(where, found, wanted)
        url = _reading_url(path)
    engines = {} if engines is None else engines
    engine = engines.get(url) or engines.setdefault(url, _engine(url, read_only=True))
    try:
        with engine.connect() as connection:
            if path is not None:
                connection.execute(text("PRAGMA busy_timeout = 5000"))
                connection.exec_driver_sql("BEGIN")  # all answers are of one moment
            schema.check_version(connection, where)
            yield connection
    except REFUSALS as error:
        reason = refusal_of(error)
        if is_damage(error):
            raise InputError(f"{where}: damaged ({reason}), expected a store") from None
        raise InputError(f"{where}: cannot be read ({reason})") from None


def check_place(url: str) -> None:
    """Raise `InputError` if a store cannot be created or opened at a place."""
    path = database_path(url)
    if path is None:
        _engine(url, read_only=False).dispose()
        return
    if path.is_dir():
        raise InputError(f"{path}: found a folder, expected a file")
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: found a pipe, socket or device, expected a file")
    if not path.parent.is_dir():
        raise InputError(f"{path}: found no folder {path.parent}, expected one")
    if _is_other_file(path) and path.suffix not in ENDINGS:
        raise InputError(f"{path}: found a file that is no database, expected a store")


def check_reachable(url: str) -> str:
    """Return a description of a database server's contents.

    Raises:
        InputError: when it cannot be reached, or holds something else.
    """
    engine = _engine(url, read_only=True)
    where = shown(url)
    try:
        with _connected(engine) as connection:
            version = schema.check_version(connection, where, may_be_empty=True)
    except REFUSALS as error:
        raise InputError(f"{where}: cannot be read ({refusal_of(error)})") from None
    return f"{where}: {f'a store of schema {version}' if version else 'empty'}"


def open_checked(url: str) -> list[tuple[str, str]]:
    """Make, upgrade or check the tables of a store before its writer starts.

    A damaged SQLite file is renamed, never deleted, and a new one takes its place.

    Returns:
        Kind and line of what a person should know: what was set aside, an upgrade.

    Raises:
        InputError: when the database is not ours, or of another version.
        sqlalchemy.exc.OperationalError: when it cannot be used now: full disk, lock, no server.
    """
    check_place(url)
    path = database_path(url)
    changes = list[tuple[str, str]]()
    if path is not None and _is_other_file(path):
        reason = "its first bytes are not those of a database"
        changes.append(("store-corrupt", set_aside(path, reason)))
    try:
        found = _prepare(url, path)
    except REFUSALS as error:
        if path is None or not is_damage(error):
            raise
        changes.append(("store-corrupt", set_aside(path, refusal_of(error))))
        found = _prepare(url, path)
    if 0 < found < schema.VERSION:
        line = f"{shown(url)}: upgraded from schema {found} to {schema.VERSION}"
        changes.append(("store-upgraded", line))
    return changes


def set_aside(path: Path, reason: str) -> str:
    """Rename a damaged database and its log for inspection; return the new path."""
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    new = path.with_name(f"{path.name}.corrupt-{stamp}")
    number = 1
    while new.exists():
        number += 1
        new = path.with_name(f"{path.name}.corrupt-{stamp}-{number}")
    for ending in ("-wal", "-shm", ""):
        part = Path(f"{path}{ending}")
        if part.exists():
            os.replace(part, f"{new}{ending}")
    return f"{path}: damaged ({reason}): set aside as {new.name}, a new one takes its place"


def refusal_of(error: Exception) -> str:
    """Return why a database or its disk refused something, in one line."""
    reason = reason_of((isinstance(error, DBAPIError) and error.orig) or error)
    return reason.lower() if isinstance(error, OSError) else reason


def is_damage(error: Exception) -> bool:
    """Return whether an error means damaged content, not a full disk or a lock."""
    said = error.orig if isinstance(error, DBAPIError) else error
    if isinstance(said, UnicodeDecodeError):
        return True
    code = getattr(said, "sqlite_errorcode", None)  # Python 3.11 and later
    if code is not None:
        return code & 0xFF in (CORRUPT, NOT_A_DATABASE)
    return isinstance(said, sqlite3.Error) and any(word in str(said) for word in DAMAGE)


def is_of_rows(error: DBAPIError) -> bool:
    """Return whether an error concerns rows, not disk, lock, link or rights."""
    if isinstance(error.orig, sqlite3.Error):
        return not (isinstance(error, OperationalError) or is_damage(error))
    return isinstance(error, (DataError, IntegrityError))


def _engine(url: str, read_only: bool, kept: int = 0) -> Engine:
    try:
        made = with_driver(make_url(url))
        postgres = made.get_backend_name() == "postgresql"
        settings = engine_settings(made, read_only) if postgres else {}
        pooled = {"pool_size": kept, "pool_pre_ping": True, "pool_use_lifo": True}
        pool: dict[str, Any] = pooled if postgres and kept else {"poolclass": NullPool}
        engine = create_engine(made, **pool, **settings)
        if postgres:
            set_deadlines(engine, made, OF_READERS if read_only else SESSION)
        return engine
    except ModuleNotFoundError as error:
        advice = f"{install_command('postgres')} and write {FORM}"
        raise InputError(
            f"{shown(url)}: found no driver {error.name}, expected psycopg: {advice}"
        ) from None
    except ArgumentError as error:
        reason = reason_of(error)[:200]
        raise InputError(f"{shown(url)}: cannot be opened ({reason})") from None


def reading_uri(path: Path) -> str:
    """Return the SQLite URI by which a file is read and never written."""
    place = (
        f"/{path.absolute().as_posix().lstrip('/')}"  # a drive of Windows has no slash before it
    )
    quoted = place.replace("%", "%25").replace("?", "%3f").replace("#", "%23")
    # A folder that may not be written has no place for the index of the log: read without one.
    alone = not os.access(path.parent, os.W_OK) and not Path(f"{path}-wal").exists()
    return f"file:{quoted}?mode=ro{'&immutable=1' if alone else ''}"


def identity(path: Path | None) -> tuple[int, int] | None:
    """Return the identity of a database file; None of other databases."""
    if path is None:
        return None
    try:
        status = path.stat()
    except FileNotFoundError:
        return (0, 0)
    return status.st_dev, status.st_ino


def _reading_url(path: Path) -> str:
    return f"sqlite:///{reading_uri(path)}&uri=true"


def _prepare(url: str, path: Path | None) -> int:
    """Make, upgrade or check the tables; return the previous version, 0 if there was none."""
    # Looked at before it is opened for writing: what is not ours, or damaged, stays as it was.
    if path is not None and path.is_file() and path.stat().st_size:
        with _connected(_engine(_reading_url(path), read_only=True)) as connection:
            found = schema.check_version(connection, shown(url), may_be_empty=True)
            if 0 < found < schema.VERSION:
                _check_room(path, found)
            if path.stat().st_size <= CHECKED_BYTES:
                problem = connection.execute(text("PRAGMA quick_check(1)")).scalar()
                if problem != "ok":
                    raise damage(str(problem))
    with _connected(writing_engine(url)) as connection, connection.begin():
        return prepare(connection, shown(url))


def _check_room(path: Path, version: int) -> None:
    """Raise `InputError` if the disk has no room for the tables that an upgrade rewrites."""
    needed, free = 2 * path.stat().st_size, shutil.disk_usage(path.parent).free  # log and file
    if free < needed:
        raise InputError(
            f"{path}: upgrade from schema {version} to {schema.VERSION}: found {free / 1e9:.2f} GB "
            f"of free disk space, expected {needed / 1e9:.2f} GB; or let it write to a new file"
        )


@contextmanager
def _connected(engine: Engine) -> Iterator[Connection]:
    try:
        with engine.connect() as connection:
            yield connection
    finally:
        engine.dispose()


def damage(reason: str) -> DBAPIError:
    """Return the error of a damaged file."""
    error = sqlite3.DatabaseError(f"malformed: {' '.join(reason.split())}")
    return DBAPIError("PRAGMA quick_check", None, error)


def _is_other_file(path: Path) -> bool:
    """Return whether a file has content but is no database."""
    if not (path.is_file() and path.stat().st_size):
        return False
    with path.open("rb") as file:
        return file.read(len(MAGIC)) != MAGIC
