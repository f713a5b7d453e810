"""Save rows in the database, or in the spool while the database does not take them.

Used by the writer's thread alone. A database server is called on another thread, as it may hang.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.store.database import (
    REFUSALS,
    damage,
    database_path,
    is_damage,
    open_checked,
    refusal_of,
    set_aside,
    shown,
)
from e3pose.store.delivery import Delivery
from e3pose.store.integrity import IntegrityWatch
from e3pose.store.postgres import ANSWER_S
from e3pose.store.retention import Retention
from e3pose.store.rows import Row, Run
from e3pose.store.spool import new_spool
from e3pose.store.timed_calls import TimedCalls

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
