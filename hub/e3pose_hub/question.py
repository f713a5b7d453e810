"""Questions in SQL over the summaries of all sites: read-only, with limits.

A question is answered by a process of its own, which the system ends at its deadline: neither
SQLite nor a driver looks at a clock within one step. Nothing of its answer is executed: it is JSON.
"""

from __future__ import annotations

import json
import os
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import closing
from decimal import Decimal
from itertools import islice
from pathlib import Path
from typing import Any

from sqlalchemy.engine import make_url

from e3pose.base.errors import InputError, reason_of
from e3pose.base.system import bound_process, ended_by_deadline
from e3pose.store.database import database_path, database_url, is_damage, reading_uri, shown
from e3pose.store.postgres import engine_settings
from e3pose_hub.database import check_role

MOST_ROWS = 10_000
LIMIT_S = 30.0
MAX_VALUE_BYTES = 10_000_000  # of one value that SQLite makes
MOST_BYTES = 1_000_000_000  # of memory that SQLite takes; it writes no temporary file
MOST_ANSWER_BYTES = 100_000_000
MOST_MEMORY = 3_000_000_000  # bytes of the process that answers
FETCHED = 10  # rows at a time
SPARE_S = 0.5  # after a deadline that the database should have kept
START_S = 15.0  # for the process to start
LIMIT_LENGTH = 0  # SQLite's number for it
EXPECTED = "one SELECT from summaries, hours, sites, accesses or forgotten"
ALLOWED = (
    sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_FUNCTION, sqlite3.SQLITE_RECURSIVE,
)  # fmt: skip


def answer(
    database: str, sql: str, limit_s: float = LIMIT_S, most_rows: int = MOST_ROWS
) -> tuple[list[str], list[Sequence[Any]]]:
    """Return the names and the rows of an answer.

    Args:
        database: of a hub: path or URL.
        sql: one statement that reads.
        limit_s: how long it may take.
        most_rows: the most that it may return.

    Raises:
        InputError: for what does not read, takes too long, or returns too much.
    """
    command = [sys.executable, "-c", f"from {__name__} import _answer; _answer()"]
    asked = json.dumps([database, sql, limit_s, most_rows])  # the address may hold a password
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, **pipes) as process:
        try:
            said, _ = process.communicate(asked.encode(), limit_s + START_S)
            late = ended_by_deadline(process.returncode)
        except subprocess.TimeoutExpired:
            said, late = b"", True
        finally:
            process.kill()
    if late:
        raise InputError(f"query: took more than {limit_s:g} s, expected a shorter question")
    if not said:
        ended = f"the process that answers ended with {process.returncode}"
        raise InputError(f"query: {ended}, expected a question that takes less memory")
    problem, names, rows = json.loads(said)
    if problem:
        raise InputError(problem)
    return names, rows


def _answer() -> None:
    """Answer the question on standard input."""
    database, sql, limit_s, most_rows = json.load(sys.stdin)
    bound_process(limit_s + SPARE_S, MOST_MEMORY)
    problem, names, rows = "", list[str](), list[Sequence[Any]]()
    try:
        names, rows = _asked(database, sql, limit_s, most_rows)
    except InputError as error:
        problem = str(error)
    except MemoryError:
        problem = f"query: needs more than {MOST_MEMORY} bytes of memory, expected fewer"
    words = json.dumps([problem, names, [[*row] for row in rows]], default=_plain)
    sys.stdout.write(words)
    sys.stdout.flush()
    os._exit(0)  # without waiting for a server that does not answer


def _plain(value: Any) -> Any:
    """Return a value as JSON has it: a number, or text."""
    return float(value) if isinstance(value, Decimal) else str(value)


def _asked(
    database: str, sql: str, limit_s: float, most_rows: int
) -> tuple[list[str], list[Sequence[Any]]]:
    url = database_url(database)
    path = database_path(url)
    if path is None:
        names, rows = _of_server(url, sql, limit_s, most_rows)
    else:
        if not path.is_file():
            raise InputError(str(path), "no such file", "the database of a hub: e3pose hub run")
        names, rows = _of_file(path, sql, limit_s, most_rows)
    if len(rows) > most_rows:
        raise InputError(f"query: found more than {most_rows} rows, expected fewer: add LIMIT")
    return names, rows


def _of_file(
    path: Path, sql: str, limit_s: float, most_rows: int
) -> tuple[list[str], list[Sequence[Any]]]:
    end_s = time.monotonic() + limit_s
    with closing(sqlite3.connect(reading_uri(path), uri=True)) as connection:
        if (limit := getattr(connection, "setlimit", None)) is not None:  # Python 3.11 and later
            limit(LIMIT_LENGTH, MAX_VALUE_BYTES)
        connection.execute("PRAGMA temp_store = MEMORY")
        connection.execute(f"PRAGMA hard_heap_limit = {MOST_BYTES}")
        connection.set_authorizer(_allowed)
        connection.set_progress_handler(lambda: int(time.monotonic() > end_s), 10_000)
        try:
            found = connection.execute(sql)
            if found.description is None:
                raise InputError("query", "no question", EXPECTED)
            return [each[0] for each in found.description], _bounded(found, most_rows)
        except MemoryError:
            raise InputError(f"query: needs more than {MOST_BYTES} bytes of memory") from None
        except InputError:
            raise
        except (sqlite3.Error, sqlite3.Warning, ValueError) as error:
            if time.monotonic() > end_s:
                found_s = f"took more than {limit_s:g} s"
                raise InputError(f"query: {found_s}, expected a shorter question") from None
            if is_damage(error):
                wanted = "the database of a hub"
                raise InputError(f"{path}: damaged ({error}), expected {wanted}") from None
            reason = str(error).rstrip(".")
            if reason == "not authorized":
                reason = "found what does more than read"
            raise InputError(f"query: {reason}, expected {EXPECTED}") from None


def _bounded(rows: Iterable[Sequence[Any]], most_rows: int) -> list[Sequence[Any]]:
    """Return rows, one more than may be at most; raise `InputError` where they are too large."""
    found, size = list[Sequence[Any]](), 0
    for row in islice(rows, most_rows + 1):
        found.append(row)
        size += sum(len(value) for value in row if isinstance(value, (str, bytes)))
        if size > MOST_ANSWER_BYTES:
            reason = f"found more than {MOST_ANSWER_BYTES} bytes, expected fewer"
            raise InputError(f"query: {reason}")
    return found


def _allowed(action: int, table: str | None, *_: str | None) -> int:
    """Let SQLite read alone; `json_each` declares itself by what looks like an update."""
    declares = action == sqlite3.SQLITE_UPDATE and table == "sqlite_master"
    return sqlite3.SQLITE_OK if action in ALLOWED or declares else sqlite3.SQLITE_DENY


def _of_server(
    url: str, sql: str, limit_s: float, most_rows: int
) -> tuple[list[str], list[Sequence[Any]]]:
    import psycopg

    parts = make_url(url)
    plain = parts.set(drivername="postgresql").render_as_string(hide_password=False)
    settings = engine_settings(parts, read_only=False)["connect_args"]
    try:
        with psycopg.connect(plain, **settings) as connection:
            connection.execute("SET TRANSACTION READ ONLY")
            connection.execute(f"SET LOCAL statement_timeout = '{round(limit_s * 1000)}ms'")
            check_role(lambda asked: connection.execute(asked).fetchone(), shown(url))
            # Of one SELECT alone can a cursor be, and what is not fetched stays at the server.
            with connection.cursor(name="question") as cursor:
                cursor.itersize = FETCHED
                cursor.execute(sql.strip().rstrip(";").encode())
                rows = _bounded(cursor, most_rows)
                return [each.name for each in cursor.description or ()], rows
    except psycopg.Error as error:
        reason = reason_of(error)[:300]
        raise InputError(f"{shown(url)}: query: {reason}, expected {EXPECTED}") from None
