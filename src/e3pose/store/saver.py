"""Save rows in the database, or in the spool while the database does not take them.

Used by the writer's thread alone. A database server is called on another thread, as it may hang.

Rows are inserted in batches, one transaction each, idempotent by run.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from sqlalchemy import ColumnElement, Connection, Insert, Table, Update, bindparam, insert, update
from sqlalchemy.dialects import postgresql
from sqlalchemy.exc import DBAPIError

from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.store import schema
from e3pose.store.database import (
    REFUSALS,
    damage,
    database_path,
    identity,
    is_damage,
    is_of_rows,
    open_checked,
    refusal_of,
    set_aside,
    shown,
    writing_engine,
)
from e3pose.store.forgetting import without_forgotten
from e3pose.store.integrity import IntegrityWatch
from e3pose.store.migrations import prepare
from e3pose.store.outbox import put, unsummed
from e3pose.store.postgres import ANSWER_S, Line, take_site
from e3pose.store.retention import Retention, give_back, trim
from e3pose.store.rows import Row, Run, track_rows
from e3pose.store.spool import LeftSpool, new_spool, spools_of
from e3pose.store.timed_calls import TimedCalls

ADOPTED_FRAMES = 5  # delivered at a time: those that come in meanwhile must not wait long


class Delivery:
    """A connection that writes, opened when it is needed; used by one thread."""

    def __init__(
        self, url: str, spools: Path | None = None, site: str | None = None, summaries: int = 0
    ) -> None:
        """Remember where to deliver; nothing is opened yet.

        Args:
            url: of the store.
            spools: what spools of processes that were killed lie beside; None where none can.
            site: of which this is the only writer on a server; None where others may write.
            summaries: minutes that the outbox keeps.
        """
        self.opened = False  # whether the tables are known to be there
        self._path, self._where, self._site = database_path(url), shown(url), site
        self._summaries = summaries
        self._engine = writing_engine(url)
        self._line = Line(self._engine) if self._path is None else None
        self._connection: Connection | None = None
        self._file: tuple[int, int] | None = None
        self._run_ids: dict[tuple[str, int], int] = {}
        self._left = [] if spools is None else spools_of(spools)
        self._adopted: Adopted | None = None

    def commit(self, rows: Sequence[Row], run: Run) -> int:
        """Write rows in one transaction; existing rows stay.

        Returns:
            Rows that the database refuses for what they are, each tried alone.

        Raises:
            sqlalchemy.exc.DBAPIError: when it takes nothing now: full, locked, damaged, gone.
        """
        if not rows:
            return 0
        try:
            self._insert(rows, run)
            return 0
        except (DBAPIError, OverflowError, UnicodeEncodeError) as error:
            if isinstance(error, DBAPIError) and not is_of_rows(error):
                raise
            self.close()
        if len(rows) == 1:
            return 1
        middle = len(rows) // 2
        return self.commit(rows[:middle], run) + self.commit(rows[middle:], run)

    @property
    def adopting(self) -> bool:
        """Whether spools of killed processes may be left to deliver."""
        return bool(self._left) or self._adopted is not None

    def adopt(self) -> str | None:
        """Deliver a part of the rows that killed processes left; return a message, if any."""
        if self._adopted is None:
            if not self._left:
                return None
            path = self._left.pop()
            try:
                self._adopted = Adopted(LeftSpool(path))
            except (BlockingIOError, FileNotFoundError):  # its owner is running, or was faster
                return None
            except InputError as error:
                return str(error)
            except OSError as error:
                return (
                    f"{path}: cannot be read ({refusal_of(error)}): its rows are not in the store"
                )
        adopted = self._adopted
        run = adopted.spool.run
        for _ in range(ADOPTED_FRAMES):
            if adopted.pending is None and not adopted.advance():
                self._adopted = None
                return adopted.finish()
            if adopted.pending is not None:
                self.commit(self._wanted(known(adopted.pending), run), run)
                adopted.rows += len(adopted.pending)
                adopted.pending = None
        return None

    def _wanted(self, rows: Sequence[Row], run: Run) -> Sequence[Row]:
        """Return late rows without those deleted in the meantime."""
        connection = self._connected()
        with connection.begin():
            return without_forgotten(connection, run.site, run.started_ns, rows)

    def trim(self, retention: Retention, now_ns: int) -> None:
        """Remove a few slots beyond the retention."""
        if retention == Retention():
            return
        connection = self._connected()
        with connection.begin():
            trim(connection, retention, now_ns)
        give_back(connection)
        connection.rollback()  # that of the last question, which would hold up the log

    def unsummed(self, run: Run, now_ns: int) -> list[Row]:
        """Return the rows of a run that no summary has."""
        connection = self._connected()
        with connection.begin():
            return unsummed(connection, run, now_ns)

    def close(self) -> None:
        """Close the connection; the next commit reopens it."""
        connection, self._connection = self._connection, None
        self._run_ids.clear()
        if connection is not None:
            try:
                connection.close()
            except (DBAPIError, OSError):  # it is in trouble: the next connection is a new one
                connection.invalidate()
        if self._line is not None:
            self._line.close()
        self._engine.dispose()

    def cut(self) -> None:
        """End the connection to a server that does not answer; on any thread."""
        if self._line is not None:
            self._line.cut()

    def connect(self) -> None:
        """Connect, and take the lock of the site on a server.

        Raises:
            InputError: when another edge of the site holds it.
        """
        self._connected()

    def _connected(self) -> Connection:
        if self._connection is not None and self._file != identity(self._path):
            self.close()  # somebody moved the file away: what we hold has no name any more
        if self._connection is None:
            self._connection = self._engine.connect()
            try:
                with self._connection.begin():
                    prepare(self._connection, self._where)
                if self._site is not None and self._path is None:
                    take_site(self._connection, self._site, self._where)
            except BaseException:
                self.close()  # without the lock it must not be used
                raise
            self._file = identity(self._path)
        return self._connection

    def _insert(self, rows: Sequence[Row], run: Run) -> None:
        connection = self._connected()
        key = (run.site, run.started_ns)
        with connection.begin():
            run_id = self._run_ids.get(key)
            if run_id is None:
                found = schema.run_id_of(connection, run.site, run.started_ns)
                if found is None:
                    connection.execute(new_rows(connection.dialect.name, schema.runs), run.row())
                    found = schema.run_id_of(connection, run.site, run.started_ns)
                assert found is not None
                run_id = found
            by_table: dict[str, list[dict[str, Any]]] = {}
            for name, row in rows:
                by_table.setdefault(name, []).append({**row, "run_id": run_id})
            put(connection, run, by_table.pop("summaries", ()), self._summaries)
            for name, content in by_table.items():
                connection.execute(new_rows(connection.dialect.name, schema.ROWS[name]), content)
            _extend_tracks(connection, run_id, track_rows(rows))
        self._run_ids[key] = run_id


@dataclass(eq=False)
class Adopted:
    """A spool of a killed process on its way into the store.

    Attributes:
        spool: the file.
        rows: delivered so far.
        damaged: places that could not be read.
        pending: read and not yet delivered.
    """

    spool: LeftSpool
    rows: int = 0
    damaged: int = 0
    pending: list[Row] | None = None

    def __post_init__(self) -> None:
        self._frames = self.spool.frames()

    def advance(self) -> bool:
        """Read on; return whether there was anything."""
        for rows in self._frames:
            self.pending = rows
            self.damaged += rows is None
            return True
        return False

    def finish(self) -> str | None:
        """Remove the file, or set it aside where parts cannot be read; return a message."""
        path, run = self.spool.path, self.spool.run
        self.spool.close()
        line = f"recovered {plural(self.rows, 'row')} from the spool of run {run.name!r}"
        if self.damaged:
            aside = path.with_name(f"{path.name.replace('.spool-', '.damaged-spool-')}")
            with suppress(OSError):
                os.replace(path, aside)
            parts = plural(self.damaged, "part")
            return f"{line}; {parts} of it cannot be read: kept as {aside}"
        with suppress(
            OSError
        ):  # of a read-only disk: delivered again at the next start, to no harm
            path.unlink(missing_ok=True)
        return line if self.rows else None


def known(rows: Sequence[Row]) -> list[Row]:
    """Return the rows that fit a table of this version.

    Those of an earlier version lack columns, all of which may be empty.
    """
    columns = {
        name: {column.name: column.nullable for column in table.columns if column.name != "run_id"}
        for name, table in schema.ROWS.items()
    }
    found = []
    for name, row in rows:
        wanted = columns.get(name, {})
        missing = wanted.keys() - row.keys()
        if wanted and row.keys() <= wanted.keys() and all(wanted[column] for column in missing):
            found.append((name, {**dict.fromkeys(missing), **row}))
    return found


@cache
def new_rows(dialect: str, table: Table) -> Insert:
    """Return an insert that keeps existing rows."""
    if dialect == "postgresql":
        return postgresql.insert(table).on_conflict_do_nothing()
    return insert(table).prefix_with("OR IGNORE")


def _at_end(end: str, beyond: ColumnElement[bool]) -> Update:
    """Return an update of one end of tracks that were seen beyond it."""
    columns = schema.tracks.c
    mine = columns.run_id == bindparam("run"), columns.track_id == bindparam("track")
    values: dict[str, Any] = {f"{end}_slot": bindparam("slot"), f"{end}_ns": bindparam("ns")}
    return update(schema.tracks).where(*mine, beyond).values(values)


_ENDS = {  # made once: a statement takes as long to make as to run
    "last": _at_end("last", schema.tracks.c.last_slot < bindparam("slot")),
    "first": _at_end("first", schema.tracks.c.first_slot > bindparam("slot")),
}


def _extend_tracks(connection: Connection, run_id: int, tracks: list[dict[str, Any]]) -> None:
    if not tracks:
        return
    made = [{**track, "run_id": run_id} for track in tracks]
    connection.execute(new_rows(connection.dialect.name, schema.tracks), made)
    for end, statement in _ENDS.items():
        seen = ((t["track_id"], t[f"{end}_slot"], t[f"{end}_ns"]) for t in tracks)
        rows = [{"run": run_id, "track": t, "slot": slot, "ns": ns} for t, slot, ns in seen]
        connection.execute(statement, rows)


RETRY_S = 1.0
SPOOL_S = 1.0  # of delivering from the spool before what came in meanwhile is looked at
NO_SLOT = -1
TROUBLE = (*REFUSALS, OSError)  # of a disk, a lock or a server, which may end by itself
Say = Callable[[str, str], None]  # kind and message of an event


class Saver:
    """Saves the rows of one run, oldest first.

    Attributes:
        spool: what the database did not take yet.
        problem: why it does not, or None.
        corrupt: files that were set aside because their content was wrong.
        refused: rows that the database cannot hold.
        first: the oldest slot that the database is to hold; -1 before the first.
        acknowledged: newest slot that it holds, with all since `first`; -1 before the first.
    """

    def __init__(
        self,
        url: str,
        run: Run,
        say: Say,
        spool: tuple[Path | None, int],
        check_s: float,
        one_writer: bool,
        summaries: int = 0,
    ) -> None:
        """Open the store, or spool from the start where it cannot be used now.

        Args:
            url: of the store.
            run: whose rows come.
            say: called with events.
            spool: the file that its name begins with, None for memory; its bytes.
            check_s: how often to check the integrity of a file.
            one_writer: whether to refuse a second writer of the run's site on a server.
            summaries: minutes that the outbox keeps.

        Raises:
            InputError: when the store is not ours, of another version, or has its writer.
        """
        self.problem: str | None = None
        self.corrupt = self.refused = 0
        self.first = self.acknowledged = self._newest = NO_SLOT
        self._url, self._run, self._say = url, run, say
        self._path, self._where = database_path(url), shown(url)
        beside, spool_bytes = spool
        self._delivery = Delivery(url, beside, run.site if one_writer else None, summaries)
        self._caller = None if self._path else TimedCalls(ANSWER_S, self._delivery.cut)
        self._watch = None if self._path is None else IntegrityWatch(self._path, check_s)
        self._next_try_s = 0.0
        self._delivered = 0  # rows, from the spool
        self._stale = False  # whether a connection is left that a call hung on
        unable: Exception | None = None
        try:
            self._open()
            self._call(self._delivery.connect)
        except TROUBLE as error:
            unable = error
        except InputError:
            self._let_go()
            raise
        self.spool = new_spool(run, beside, spool_bytes)
        if unable is not None:
            self._fail(unable)

    def save(self, rows: Sequence[Row], first: int, newest: int) -> None:
        """Commit rows, or spool them while the database does not take them.

        Args:
            rows: of one commit.
            first: the oldest slot in them, or -1.
            newest: the newest, or -1.
        """
        self.first = first if self.first == NO_SLOT else self.first
        self._newest = max(self._newest, newest)
        spooled = self.problem is not None
        if spooled:
            self._add(rows)
            if time.monotonic() < self._next_try_s:
                return
        elif not rows:
            return
        try:
            if not self._delivery.opened:
                self._open()
            if spooled:
                self._deliver_spool()
            else:
                self._commit(rows)
        except (*TROUBLE, InputError) as error:
            if not spooled:
                self._add(rows)
            self._fail(error)
            return
        if not len(self.spool):
            self.acknowledged = max(self.acknowledged, self._newest)
            self._recover()

    def unsummed(self, now_ns: int) -> list[Row]:
        """Return the rows of the run that no summary has, as a killed program left them."""
        found: list[Row] = []
        try:
            if self.problem is None:
                self._call(lambda: found.extend(self._delivery.unsummed(self._run, now_ns)))
        except (*TROUBLE, InputError) as error:
            self._fail(error)
        return found

    def keep_house(self, retention: Retention, now_ns: int) -> None:
        """Do deferrable work, a little after every commit."""
        if self.problem is not None:
            return
        try:
            if self._delivery.adopting:
                self._call(self._adopt)
            if retention != Retention():
                self._call(lambda: self._delivery.trim(retention, now_ns))
            if self._watch is not None and (wrong := self._watch.check()):
                raise damage(wrong)
        except (*TROUBLE, InputError) as error:
            self._fail(error)

    def close(self) -> None:
        """Let the database go; rows that are spooled stay in their file."""
        if self._watch is not None:
            self._watch.close()
        self._let_go()
        if len(self.spool) and not self.spool.in_file:
            self.refused += len(self.spool)
        self.spool.close(keep=len(self.spool) > 0)

    def _deliver_spool(self) -> None:
        """Commit the oldest rows of the spool, for a while."""
        until_s = time.monotonic() + SPOOL_S
        while time.monotonic() < until_s and (kept := self.spool.oldest()):
            self._commit(kept)
            self.spool.drop()
            self._delivered += len(kept)

    def _recover(self) -> None:
        if self.problem is None:
            return
        self.problem = None
        rows, self._delivered = plural(self._delivered, "row"), 0
        self._say(
            "store-recovered", f"{self._where}: writable again, {rows} written from the spool"
        )

    def _commit(self, rows: Sequence[Row]) -> None:
        refused: list[int] = []
        self._call(lambda: refused.append(self._delivery.commit(rows, self._run)))
        if refused[0]:
            self.refused += refused[0]
            self._say("store-refused", f"the database rejected {plural(refused[0], 'row')}")

    def _adopt(self) -> None:
        if (line := self._delivery.adopt()) is not None:
            self._say("store-adopted", line)

    def _add(self, rows: Sequence[Row]) -> None:
        in_file = self.spool.in_file
        self.spool.add(rows)
        if in_file and not self.spool.in_file:
            self._say("store-spool", f"{self.spool.path}: not writable: records wait in memory")

    def _fail(self, error: Exception) -> None:
        self._let_go()
        self._next_try_s = time.monotonic() + RETRY_S
        reason = refusal_of(error)
        known, self.problem = self.problem is not None, reason
        if self._path is not None and is_damage(error):
            self._set_aside(self._path, reason, known)
        elif not known:
            where = f"the file {self.spool.path}" if self.spool.in_file else "memory"
            kind = "store-full" if "full" in reason or "space" in reason else "store-trouble"
            self._say(kind, f"{self._where}: not writable ({reason}): spooling to {where}")

    def _set_aside(self, path: Path, reason: str, known: bool) -> None:
        try:
            self.corrupt += 1
            self._say("store-corrupt", set_aside(path, reason))
            self._delivery.opened = False
            if self.first != NO_SLOT:  # what came before is in the file that was set aside
                self.first = self.acknowledged + 1
        except OSError as refused:
            if not known:
                self._say("store-corrupt", f"damaged ({reason}), cannot be moved ({refused})")

    def _open(self) -> None:
        def opened() -> None:
            for kind, message in open_checked(self._url):
                self.corrupt += kind == "store-corrupt"
                self._say(kind, message)
            self._delivery.opened = True

        self._call(opened, patient=True)

    def _let_go(self) -> None:
        try:
            self._call(self._delivery.close)
        except TimeoutError:  # it ends when the call does that uses it
            self._stale = True

    def _call(self, body: Callable[[], object], patient: bool = False) -> None:
        def fresh() -> None:
            if self._stale:
                self._delivery.close()
                self._stale = False
            body()

        if self._caller is None:
            body()
        else:
            self._caller.call(fresh, patient=patient)
