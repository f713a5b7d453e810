"""A question over archives, and the process that answers it: DuckDB reads its files, no others.

What DuckDB says of its memory holds for its tables, not for every function: the system bounds all.
"""

from __future__ import annotations

import os
import pickle
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from e3pose.base.system import bound_memory, stand_back

THREADS = 2
# What there is where an archive holds nobody.
NOBODY = (
    "SELECT NULL::VARCHAR site, NULL::DATE AS day, NULL::BIGINT started_ns, NULL::BIGINT time_ns, "
    "NULL::TIMESTAMP AS time, NULL::INTEGER slot, NULL::INTEGER track WHERE false"
)
POSES = """SELECT p.site, p.day, f.started_ns,
    CASE WHEN f.interval_s > 0 THEN f.started_ns + (slot * f.interval_s * 1e9)::BIGINT END time_ns,
    make_timestamp(time_ns // 1000) AS time, p.* EXCLUDE (site, day, filename)
FROM read_parquet({files}, union_by_name = {mixed}, filename = true, hive_partitioning = true,
    hive_types = {{'site': VARCHAR, 'day': DATE}}) p
JOIN files f ON f.site = p.site AND f.day = p.day AND f.name = parse_filename(p.filename)"""


@dataclass(frozen=True, slots=True)
class File:
    """A file of an archive.

    Attributes:
        address: path, or address that fsspec knows.
        site, day, hour: of its poses, UTC.
        run: what a person calls the run.
        started_ns: when the run began.
        interval_s: seconds per slot.
        skeleton: of the poses.
        slots, rows, bytes: of the hour, and of the file.
    """

    address: str
    site: str
    day: str
    hour: int
    run: str
    started_ns: int
    interval_s: float
    skeleton: str
    slots: int
    rows: int
    bytes: int


@dataclass(frozen=True, slots=True)
class Question:
    """What the process is asked.

    Attributes:
        sql: one statement that reads.
        files: that it may read, and no others.
        most_rows: it returns one more than these at most.
        most_bytes: of memory.
        limit_s: of time.
    """

    sql: str
    files: tuple[File, ...]
    most_rows: int
    most_bytes: int
    limit_s: float


def main() -> None:
    """Answer the question that comes in; its answer or what is wrong with it goes out."""
    import duckdb

    stand_back()
    question = pickle.load(sys.stdin.buffer)  # of our own program
    problem, names, rows = "", list[str](), list[Any]()
    try:
        names, rows = _answer(question)
    except duckdb.InterruptException:
        problem = "late"
    except (duckdb.Error, RuntimeError, UnicodeError) as error:
        said = str(error).partition("\nLINE ")[0]  # then the question again
        problem = " ".join(said.split())[:300] or type(error).__name__
    sys.stdout.buffer.write(pickle.dumps((problem, names, rows)))
    sys.stdout.buffer.flush()
    os._exit(0)  # threads of DuckDB that call Python must not outlive the interpreter


def _answer(question: Question) -> tuple[list[str], list[Any]]:
    import duckdb

    connection = duckdb.connect(
        ":memory:",
        config={
            "memory_limit": f"{question.most_bytes // 2}B",
            "threads": THREADS,
            "temp_directory": "",
            "autoinstall_known_extensions": False,
            "autoload_known_extensions": False,
            "python_enable_replacements": False,
        },
    )
    _tables(connection, question.files)
    bound_memory(question.most_bytes)
    statements = connection.extract_statements(question.sql)
    if len(statements) != 1:
        raise RuntimeError(f"found {len(statements)} statements")
    if statements[0].type != duckdb.StatementType.SELECT:
        raise RuntimeError("found what does more than read")
    timer = threading.Timer(question.limit_s, connection.interrupt)
    timer.daemon = True
    timer.start()
    found = connection.execute(statements[0])
    rows = found.fetchmany(question.most_rows + 1)
    timer.cancel()
    return [each[0] for each in found.description or ()], rows


def _tables(connection: Any, files: Sequence[File]) -> None:
    """Make `files` and `poses`; from then on no other file can be opened."""
    import pyarrow

    for protocol in {file.address.partition("://")[0] for file in files if "://" in file.address}:
        import fsspec

        connection.register_filesystem(fsspec.filesystem(protocol))
    addresses = [file.address for file in files]
    connection.execute("SET allowed_paths = $1", [addresses])
    connection.execute("SET enable_external_access = false")
    names = "site", "day", "hour", "run", "started_ns", "interval_s", "skeleton", "slots"
    columns = {n: [getattr(f, n) for f in files] for n in (*names, "rows", "bytes")}
    columns = {"name": [address.rpartition("/")[2] for address in addresses], **columns}
    connection.register("listed", pyarrow.table(columns))
    connection.execute("CREATE TABLE files AS SELECT * REPLACE (day::DATE AS day) FROM listed")
    connection.unregister("listed")
    if not files:
        connection.execute(f"CREATE VIEW poses AS {NOBODY}")
    else:
        listed = ", ".join("'{}'".format(address.replace("'", "''")) for address in addresses)
        mixed = len({file.skeleton for file in files}) > 1 or not files[0].skeleton
        connection.execute(f"CREATE VIEW poses AS {POSES.format(files=f'[{listed}]', mixed=mixed)}")
    connection.execute("SET lock_configuration = true")
