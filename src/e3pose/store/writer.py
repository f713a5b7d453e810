"""The writer of a store: a thread that commits slots in groups.

`append` hands a record over and returns. The thread commits what came within `commit_s`; what is
committed is acknowledged and survives `kill -9`. When the database does not take it, rows go to a
bounded spool and from there to the database as soon as it does.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from e3pose.errors import InputError
from e3pose.model.zone_event import ZoneEvent
from e3pose.pipeline import SlotRecord
from e3pose.quantities import plural
from e3pose.runtime.thread_name import show_thread_name
from e3pose.store.database import (
    REFUSALS,
    damage,
    database_path,
    database_url,
    is_damage,
    open_checked,
    reason_of,
    set_aside,
)
from e3pose.store.delivery import Delivery
from e3pose.store.integrity import Watch
from e3pose.store.retention import SIZE_OF_SERVER, Retention
from e3pose.store.rows import (
    NS,
    EnergyReading,
    Event,
    Floats,
    Row,
    Run,
    energy_row,
    event_row,
    slot_rows,
    zone_row,
)
from e3pose.store.spool import DEFAULT_BYTES, new_spool

RETRY_S = 1.0
NO_SLOT = -1


@dataclass(frozen=True, slots=True)
class WriterSettings:
    """How a writer works.

    Attributes:
        commit_s: the longest that a record waits to be committed with those after it.
        commit_slots: commit earlier when this many wait.
        queue_slots: records kept while the thread is busy; more are shed, and counted.
        spool_bytes: room for what the database cannot take.
        spool_beside: a name in the folder that the spool is kept in, where the store is no file;
            None for memory.
        check_s: how often to check the integrity of the file.
        retention: what to keep.
    """

    commit_s: float = 0.5  # with the commit itself well within the second that is promised
    commit_slots: int = 256
    queue_slots: int = 2000
    spool_bytes: int = DEFAULT_BYTES
    spool_beside: Path | None = None
    check_s: float = 60.0
    retention: Retention = field(default_factory=Retention)


@dataclass(frozen=True, slots=True)
class WriterStatus:
    """How a writer is doing.

    Attributes:
        acknowledged_slot: newest slot that is in the database with all before it that were not
            spooled or shed; -1 before the first.
        waiting: records handed over and not yet delivered.
        spooled: rows waiting for room in the database.
        shed: records and rows given up.
        problem: what keeps the database from taking more, or None.
        corrupt: files that were set aside because their content was wrong.
    """

    acknowledged_slot: int
    waiting: int
    spooled: int
    shed: int
    problem: str | None
    corrupt: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class _Slot:
    record: SlotRecord
    time_ns: int
    energy_j: Floats | None


_Item = (
    _Slot | Event | EnergyReading | ZoneEvent | threading.Event
)  # an event to set once all before it is done


class StoreWriter:
    """Writes one run into a store. Use as a context manager, or `close` it."""

    def __init__(
        self,
        store: str | Path,
        run: Run,
        settings: WriterSettings | None = None,
        report: Callable[[Event], None] | None = None,
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """Open the store and start the thread.

        A full disk or a lock is no reason not to start: the spool takes what comes.

        Args:
            store: a path (SQLite) or the URL of a database.
            run: what is about to be written.
            settings: how.
            report: called, from the writer's thread, with what a person should know.
            wall_ns: nanoseconds since 1970, UTC.

        Raises:
            InputError: when the store is not ours, of another version, or cannot keep to a size.
        """
        self.run = run
        self.settings = settings or WriterSettings()
        self._report, self._wall_ns = report, wall_ns
        self._url = database_url(store)
        self._path = database_path(self._url)
        if self._path is None and self.settings.retention.max_bytes is not None:
            raise InputError(SIZE_OF_SERVER)
        beside = self._path or self.settings.spool_beside
        # No lock and nobody woken when a slot is appended: one deque operation, and the thread
        # looks for itself. A queue's lock made the loop wait for the thread now and then.
        self._items: deque[_Item] = deque()
        self._wake = threading.Event()
        self._stop = threading.Event()
        self._shed = self._reported_shed = self._events = self._corrupt = 0
        self._shed_lock = threading.Lock()  # counted here and by those who hand over
        self._acknowledged = NO_SLOT
        self._problem: str | None = None
        self._next_try_s = 0.0
        self._notes: list[Event] = []
        self._delivery = Delivery(self._url, beside)
        self._watch = None if self._path is None else Watch(self._path, self.settings.check_s)
        unable: Exception | None = None
        try:
            self._open()
        except (*REFUSALS, OSError) as error:
            unable = error
        self._spool = new_spool(run, beside, self.settings.spool_bytes)
        if unable is not None:
            self._fail(unable)
        self._thread = threading.Thread(target=self._work, name="store", daemon=True)
        self._thread.start()

    def append(
        self,
        record: SlotRecord,
        *,
        time_ns: int | None = None,
        energy_j: Floats | None = None,
        wait: bool = False,
    ) -> bool:
        """Hand over one slot; never waits for the database.

        Args:
            record: what the slot left behind; its arrays must not change afterwards.
            time_ns: when it was captured; by default the run's start and the record's time.
            energy_j: `(num_cameras,)` joules that the slot is charged with, where known.
            wait: wait for room in the queue, for those who can: a replay.

        Returns:
            Whether it was taken; False when the queue is full.
        """
        if time_ns is None:
            time_ns = self.run.started_ns + round(record.time_s * NS)
        return self._hand_over(_Slot(record, time_ns, energy_j), wait)

    def event(self, event: Event) -> bool:
        """Hand over an event; return whether it was taken."""
        return self._hand_over(event, wait=False)

    def energy(self, reading: EnergyReading) -> bool:
        """Queue a meter reading; return whether it was accepted."""
        return self._hand_over(reading, wait=False)

    def zone(self, event: ZoneEvent) -> bool:
        """Hand over what happened in a zone; return whether it was taken."""
        return self._hand_over(event, wait=False)

    def status(self) -> WriterStatus:
        """Return how the writer is doing; cheap enough for every slot."""
        return WriterStatus(
            acknowledged_slot=self._acknowledged,
            waiting=len(self._items),
            spooled=len(self._spool),
            shed=self._shed + self._spool.lost_rows,
            problem=self._problem,
            corrupt=self._corrupt,
        )

    def flush(self, timeout_s: float = 10.0) -> bool:
        """Wait until all that was handed over is committed, or spooled; return whether it is."""
        done = threading.Event()
        self._items.append(done)
        self._wake.set()
        return done.wait(timeout_s)

    def close(self, timeout_s: float = 10.0) -> None:
        """Commit the queue and end the thread; spooled rows stay in their file."""
        self._stop.set()
        self._wake.set()
        self._thread.join(timeout_s)

    def __enter__(self) -> StoreWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _hand_over(self, item: _Item, wait: bool) -> bool:
        while len(self._items) >= self.settings.queue_slots:
            if not wait or not self._thread.is_alive():
                self._count_shed(1)
                return False
            self._wake.set()
            time.sleep(0.002)
        self._items.append(item)
        return True

    def _count_shed(self, records: int) -> None:
        with self._shed_lock:
            self._shed += records

    # What follows runs in the writer's thread.

    def _work(self) -> None:
        show_thread_name()
        stopping = False
        while not stopping:
            if len(self._items) < self.settings.commit_slots:
                self._wake.wait(self.settings.commit_s)
                self._wake.clear()
            # Asked before taking: whatever was handed over by then is still taken.
            stopping = self._stop.is_set() and len(self._items) <= self.settings.commit_slots
            rows, newest, waiting = self._gather()
            try:
                self._deliver(rows, newest)
                self._keep_house()
            except Exception as error:  # whatever it is, the slots that follow must find a writer
                self._count_shed(len(rows))
                self._say("store-error", f"{type(error).__name__}: {error}")
            for done in waiting:
                done.set()
        if self._watch is not None:
            self._watch.close()
        self._delivery.close()
        self._spool.close(keep=len(self._spool) > 0)

    def _gather(self) -> tuple[list[Row], int, list[threading.Event]]:
        """Return the rows of one commit, the newest slot in them, and who waits for them."""
        rows: list[Row] = []
        waiting: list[threading.Event] = []
        newest = NO_SLOT
        for _ in range(min(len(self._items), self.settings.commit_slots)):
            item = self._items.popleft()
            if isinstance(item, threading.Event):
                waiting.append(item)
                continue
            if isinstance(item, _Slot):
                newest = max(newest, item.record.slot)
            rows += self._encode(item)
            time.sleep(0)  # lets the loop have the interpreter in the middle of a batch
        if self._shed + self._spool.lost_rows > self._reported_shed:
            count = self._shed + self._spool.lost_rows
            self._say(
                "store-shed", f"{plural(count - self._reported_shed, 'record')} dropped: spool full"
            )
            self._reported_shed = count
        notes, self._notes = self._notes, []
        for note in notes:
            rows += self._encode(note)
        return rows, newest, waiting

    def _encode(self, item: _Slot | Event | EnergyReading | ZoneEvent) -> list[Row]:
        try:
            if isinstance(item, _Slot):
                return slot_rows(item.record, item.time_ns, item.energy_j)
            if isinstance(item, EnergyReading):
                return [energy_row(item)]
            if isinstance(item, ZoneEvent):
                return [zone_row(item)]
            self._events += 1
            return [event_row(item, self._events)]
        except (InputError, ValueError, TypeError) as error:
            self._say("store-refused", str(error))
            return []

    def _deliver(self, rows: list[Row], newest: int) -> None:
        """Commit rows, or spool them while the database refuses them."""
        if self._problem is not None and time.monotonic() < self._next_try_s:
            self._spool.add(rows)
            return
        if not rows and self._problem is None:
            return
        try:
            if not self._delivery.opened:
                self._open()
            self._commit(rows)
            if len(self._spool):
                for kept in self._spool.take():
                    self._commit(kept)
        except (*REFUSALS, OSError, InputError) as error:
            self._spool.add(rows)
            self._fail(error)
            return
        self._acknowledged = max(self._acknowledged, newest)
        if self._problem is not None:
            kept_rows = len(self._spool)
            self._spool.clear()
            self._problem = None
            self._say(
                "store-recovered",
                f"the store is writable again, {plural(kept_rows, 'row')} written from the spool",
            )

    def _commit(self, rows: Sequence[Row], run: Run | None = None) -> None:
        refused = self._delivery.commit(rows, run or self.run)
        if refused:
            self._count_shed(refused)
            self._say("store-refused", f"the database rejected {plural(refused, 'row')}")

    def _fail(self, error: Exception) -> None:
        self._delivery.close()
        self._next_try_s = time.monotonic() + RETRY_S
        reason = reason_of(error)
        known, self._problem = self._problem is not None, reason
        if self._path is not None and is_damage(error):
            try:
                self._corrupt += 1
                self._say("store-corrupt", set_aside(self._path, reason))
                self._delivery.opened = False
            except OSError as refused:
                if not known:
                    self._say("store-corrupt", f"damaged ({reason}), cannot be moved ({refused})")
        elif not known:
            where = "file" if self._spool.in_file else "memory"
            kind = "store-full" if "full" in reason or "space" in reason else "store-trouble"
            self._say(kind, f"the store is not writable ({reason}): spooling to a {where}")

    def _open(self) -> None:
        for kind, message in open_checked(self._url):
            self._corrupt += kind == "store-corrupt"
            self._say(kind, message)
        self._delivery.opened = True

    def _keep_house(self) -> None:
        """Do what can wait, a little after every commit."""
        if self._problem is not None:
            return
        try:
            for adopted in self._delivery.adopt():
                self._say("store-adopted", adopted)
            self._delivery.trim(self.settings.retention, self._wall_ns())
            if self._watch is not None and (wrong := self._watch.check()):
                raise damage(wrong)
        except (*REFUSALS, OSError) as error:
            self._fail(error)

    def _say(self, kind: str, message: str) -> None:
        event = Event(self._wall_ns(), kind, message)
        self._notes.append(event)
        if self._report is not None:
            self._report(event)
