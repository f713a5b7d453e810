"""Copy a store at one moment: backup, restore, another database."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from sqlalchemy import Connection, Table, func, insert, inspect, select, text, update

from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError
from e3pose.store import schema
from e3pose.store.database import (
    REFUSALS,
    check_place,
    database_path,
    database_url,
    reading,
    refusal_of,
    shown,
    writing_engine,
)
from e3pose.store.migrations import prepare
from e3pose.store.query import columns_of

CHUNK_ROWS = 5000
TABLES = (schema.runs, *schema.ROWS.values())


def copy_store(
    source: str | Path, dest: str | Path, progress: Callable[[str, int, int], None]
) -> dict[str, int]:
    """Copy a whole store to a place without runs.

    The source may be written meanwhile: what is copied is what it held at the beginning. Of what
    is copied, all is there at the end or nothing.

    Args:
        source: path or URL.
        dest: a file that does not exist, or the URL of a database.
        progress: called with a table's name, rows copied and rows in all.

    Returns:
        Rows by table.

    Raises:
        InputError: when one of them cannot be used, or the destination holds something.
    """
    url = database_url(dest)
    check_place(url)
    path, where = database_path(url), shown(url)
    if path is not None and path.exists():
        raise InputError(f"{where}: found a file, expected a name that is free")
    with reading(source) as found, ExitStack() as stack:
        if path is not None:
            part = stack.enter_context(atomic_file(path, private=True))
            url = database_url(part)
        engine = writing_engine(url)
        stack.callback(engine.dispose)
        try:
            with engine.begin() as made:
                prepare(made, where)
                if made.execute(select(schema.runs.c.run_id).limit(1)).first() is not None:
                    raise InputError(f"{where}: found runs in it, expected an empty store")
                return _copied(found, made, progress)
        except REFUSALS as error:
            raise InputError(f"{where}: cannot be written ({refusal_of(error)})") from None
    raise AssertionError("an exit stack lets no error pass")


def _copied(
    found: Connection, made: Connection, progress: Callable[[str, int, int], None]
) -> dict[str, int]:
    there = set(inspect(found).get_table_names())  # fewer in a store of an earlier version
    counts = {}
    for table in TABLES:
        if table.name in there:
            counts[table.name] = _copy_table(found, made, table, progress)
    if schema.outboxes.name in there:
        # A cursor of the source says nothing about what the copy gets from now on.
        _copy_table(found, made, schema.outboxes, lambda *_: None)
        made.execute(update(schema.outboxes).values(begun_ns=time.time_ns()))
    if schema.forgotten.name in there:
        for table in (schema.forgotten, schema.archives):
            _copy_table(found, made, table, lambda *_: None)
    if made.dialect.name == "postgresql":  # the next run gets a number that no run had
        last = "SELECT setval(pg_get_serial_sequence('runs', 'run_id'), max(run_id)) FROM runs"
        made.execute(text(last))
    return counts


def _copy_table(
    found: Connection,
    made: Connection,
    table: Table,
    progress: Callable[[str, int, int], None],
) -> int:
    total = found.execute(select(func.count()).select_from(table)).scalar_one()
    done = 0
    asked = select(*columns_of(found, table)).order_by(*table.primary_key)
    with found.execution_options(yield_per=CHUNK_ROWS).execute(asked) as result:
        for rows in result.mappings().partitions():
            made.execute(insert(table), [dict(row) for row in rows])
            done += len(rows)
            progress(table.name, done, total)
    return done
