"""Questions in SQL over archives of poses: DuckDB in a process of its own, with limits."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Collection, Iterator, Sequence
from importlib.util import find_spec
from typing import Any

from e3pose.base.apart import kill_all, start_apart
from e3pose.base.errors import InputError
from e3pose.hub.accesses import log_accesses
from e3pose.hub.database import open_hub
from e3pose.hub.duck import File, Question
from e3pose.hub.question import LIMIT_S, MOST_ROWS, late
from e3pose.hub.settings import Hub
from e3pose.output.archive.manifest import MARK, Manifest, days_of, read_manifest
from e3pose.output.archive.places import Place, place_of

MOST_BYTES = 2_000_000_000  # of memory that a question takes
EXPECTED = "one SELECT from poses or files"
START_S = 10.0  # for DuckDB to be there, beside the question's own time
GLOBS = "*?[]"  # which DuckDB would look for other files with


def answer_of_archives(
    hub: Hub,
    sql: str,
    who: str,
    groups: Collection[str] | None = None,
    limit_s: float = LIMIT_S,
    most_rows: int = MOST_ROWS,
    most_bytes: int = MOST_BYTES,
) -> tuple[list[str], list[Sequence[Any]]]:
    """Return the names and the rows of an answer; the access is logged before.

    Args:
        hub: its file.
        sql: one statement that reads `poses` and `files`.
        who: asks, for the log.
        groups: of sites that are read; all for None.
        limit_s: how long it may take.
        most_rows: the most that it may return.
        most_bytes: of memory that it may take.

    Raises:
        InputError: for what does not read, takes too long or too much, or returns too much, and
            where an archive cannot be read or the access cannot be logged.
    """
    if find_spec("duckdb") is None:
        raise ModuleNotFoundError(name="duckdb")
    if not hub.archives:
        raise InputError(f"{hub.path}: archives: found none, expected folders or addresses")
    wanted = hub.of_groups(groups)
    files = tuple(file for at in hub.archives for file in files_of(place_of(at), wanted))
    sites = sorted({file.site for file in files})
    log_accesses(open_hub(hub.database), who, sites, f"query: {' '.join(sql.split())}")
    names, rows = _asked(Question(sql, files, most_rows, most_bytes, limit_s))
    if len(rows) > most_rows:
        raise InputError(f"query: found more than {most_rows} rows, expected fewer: add LIMIT")
    return names, rows


def files_of(place: Place, sites: Collection[str]) -> Iterator[File]:
    """Yield what the manifests of an archive name, of some sites.

    Raises:
        InputError: for an archive that is not there, or cannot be read.
    """
    if place.read(MARK) is None:
        raise InputError(f"archives: {place.name}", "no archive", "one that e3pose archive made")
    for site in sites:
        for _, day in days_of(place, site):
            manifest = read_manifest(place, site, day) or Manifest(site, day)
            for name, entry in manifest.files.items():
                if not entry.sha256:
                    continue  # nobody was there
                address = place.address(f"{manifest.folder}/{name}")
                if set(address) & set(GLOBS):
                    raise InputError(f"{place.name}", "one of * ? [ ]", "a name without them")
                yield File(
                    address, site, day, entry.hour, entry.run, entry.started_ns, entry.interval_s,
                    entry.skeleton, entry.slots, entry.rows, entry.bytes,
                )  # fmt: skip


def _asked(question: Question) -> tuple[list[str], list[Sequence[Any]]]:
    command = [sys.executable, "-c", "from e3pose.hub.duck import main; main()"]
    process = start_apart(command, subprocess.PIPE, subprocess.PIPE, subprocess.PIPE)
    try:
        output, errors = process.communicate(pickle.dumps(question), question.limit_s + START_S)
    except subprocess.TimeoutExpired:
        raise InputError(late(question.limit_s)) from None
    finally:
        kill_all(process)
        process.wait()
    if process.returncode:
        said = errors.decode(errors="replace").strip().splitlines()
        reason = said[-1][:300] if said else ""
        if process.returncode < 0:
            reason = f"ended by signal {-process.returncode}, as where memory runs out"
        raise InputError(f"query: {reason}, expected {EXPECTED}")
    problem, names, rows = pickle.loads(output)  # of our own program
    if problem:
        if problem == "late":
            raise InputError(late(question.limit_s))
        raise InputError(f"query: {problem}, expected {EXPECTED}")
    return names, rows
