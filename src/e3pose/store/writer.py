"""The writer of a store: a thread that commits slots in groups.

`append` hands a record over and returns. The thread commits what came within `commit_s`; what is
committed is acknowledged and survives `kill -9`. When the database does not take it, rows go to a
bounded spool and from there to the database as soon as it does.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.base.threads import show_thread_name
from e3pose.model.zone_event import ZoneEvent
from e3pose.pipeline import SlotRecord
from e3pose.store.database import database_path, database_url
from e3pose.store.retention import SIZE_OF_SERVER, Retention
from e3pose.store.rows import (
    NS,
    EnergyReading,
    Event,
    Presence,
    Row,
    Run,
    energy_row,
    event_row,
    slot_rows,
    zone_row,
)
from e3pose.store.saver import NO_SLOT, Saver
from e3pose.store.spool import DEFAULT_BYTES
from e3pose.store.summaries import Minutes

COMMIT_S = 0.5  # with the commit itself well within the second that is promised
COMMIT_SOON_S = 0.1  # where poses are published once they are stored


@dataclass(frozen=True, slots=True)
class WriterSettings:
    """Settings of a writer.

    Attributes:
        commit_s: the longest that a record waits to be committed with those after it.
        commit_slots: commit earlier when this many wait.
        queue_slots: records kept while the thread is busy; more are shed, and counted.
        spool_bytes: room for what the database cannot take.
        spool_beside: a name in the folder that the spool is kept in, where the store is no file;
            None for memory.
        check_s: how often to check the integrity of the file.
        retention: what to keep.
        one_writer: refuse to be the second writer of a site on a database server.
        summaries: minutes kept in the outbox, the newest; 0 for none.
        titles: what summaries call cameras, by id; the id where one is not there.
    """

    commit_s: float = COMMIT_S
    commit_slots: int = 256
    queue_slots: int = 2000
    spool_bytes: int = DEFAULT_BYTES
    spool_beside: Path | None = None
    check_s: float = 60.0
    retention: Retention = field(default_factory=Retention)
    one_writer: bool = False
    summaries: int = 0
    titles: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class WriterStatus:
    """The status of a writer.

    Attributes:
        acknowledged_slot: newest slot that is in the database, with all from `first_slot` on that
            are not counted in `shed`; -1 before the first.
        waiting: records handed over and not yet delivered.
        spooled: rows waiting for room in the database.
        shed: records and rows given up.
        problem: what keeps the database from taking more, or None.
        corrupt: files that were set aside because their content was wrong.
        first_slot: the oldest slot that was handed over, and is not in a file that was set aside;
            -1 before the first.
    """

    acknowledged_slot: int
    waiting: int
    spooled: int
    shed: int
    problem: str | None
    corrupt: int = 0
    first_slot: int = NO_SLOT


@dataclass(frozen=True, slots=True, eq=False)
class _Slot:
    record: SlotRecord
    time_ns: int
    energy_j: Floats | None


_Item = (
    _Slot | Event | EnergyReading | ZoneEvent | Presence | threading.Event
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
        path = database_path(self._url)
        if path is None and self.settings.retention.max_bytes is not None:
            raise InputError(SIZE_OF_SERVER)
        # No lock and nobody woken when a slot is appended: one deque operation, and the thread
        # looks for itself. A queue's lock made the loop wait for the thread now and then.
        self._items: deque[_Item] = deque()
        self._wake = threading.Event()
        self._stop = threading.Event()
        self._shed = self._reported_shed = self._reported_lost = self._events = 0
        self._shed_lock = threading.Lock()  # for those who hand over
        self._given_up = 0  # by the writer's thread, each with an event of its own
        self._notes: list[Event] = []
        self._saver = Saver(
            self._url,
            run,
            self._say,
            (path or self.settings.spool_beside, self.settings.spool_bytes),
            self.settings.check_s,
            self.settings.one_writer,
            self.settings.summaries,
        )
        self._minutes: Minutes | None = None
        if self.settings.summaries:
            self._minutes = Minutes(run.software, run.cameras, wall_ns(), self.settings.titles)
        self._thread = threading.Thread(target=self._work, name="store", daemon=True)
        self._thread.start()

    def keep(self, max_age_s: float | None, max_bytes: int | None) -> None:
        """Keep to other bounds from now on, see `Retention`; may be called on any thread.

        Raises:
            InputError: for a size, of a database server.
        """
        if max_bytes is not None and database_path(self._url) is None:
            raise InputError(SIZE_OF_SERVER)
        self.settings = replace(self.settings, retention=Retention(max_age_s, max_bytes))

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
        """Hand over an event; return whether it was taken.

        A flood of events leaves half of the queue to slots.
        """
        if len(self._items) >= self.settings.queue_slots // 2:
            return self._refuse()
        return self._hand_over(event, wait=False)

    def energy(self, reading: EnergyReading) -> bool:
        """Queue a meter reading; return whether it was accepted."""
        return self._hand_over(reading, wait=False)

    def zone(self, event: ZoneEvent) -> bool:
        """Hand over a zone event; return whether it was taken."""
        return self._hand_over(event, wait=False)

    def present(self, now: Presence) -> bool:
        """Hand over states of people, for summaries; return whether they were taken."""
        return self._hand_over(now, wait=False)

    def status(self) -> WriterStatus:
        """Return how the writer is doing; cheap enough for every slot."""
        saver = self._saver
        return WriterStatus(
            acknowledged_slot=saver.acknowledged,
            waiting=len(self._items),
            spooled=len(saver.spool),
            shed=self._shed + self._given_up + saver.refused + saver.spool.lost_rows,
            problem=saver.problem,
            corrupt=saver.corrupt,
            first_slot=saver.first,
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
                return self._refuse()
            self._wake.set()
            time.sleep(0.002)
        self._items.append(item)
        return True

    def _refuse(self) -> bool:
        """Count an item that finds no room."""
        with self._shed_lock:
            self._shed += 1
        return False

    # What follows runs in the writer's thread.

    def _work(self) -> None:
        show_thread_name()
        stopping, summaries = False, list[Row]()
        if self._minutes is not None:
            summaries = self._sum_up(self._saver.unsummed(self._minutes.begun_ns))
        while not stopping:
            if len(self._items) < self.settings.commit_slots:
                self._wake.wait(self.settings.commit_s)
                self._wake.clear()
            # Asked before taking: whatever was handed over by then is still taken.
            stopping = self._stop.is_set() and len(self._items) <= self.settings.commit_slots
            rows, slots, waiting = self._gather()
            rows, summaries = rows + summaries + self._sum_up(rows, stopping), []
            try:
                self._saver.save(rows, *slots)
                self._saver.keep_house(self.settings.retention, self._wall_ns())
            except Exception as error:  # whatever it is, the slots that follow must find a writer
                self._given_up += len(rows)
                self._say("store-error", f"{type(error).__name__}: {error}")
            for done in waiting:
                done.set()
        self._saver.close()

    def _gather(self) -> tuple[list[Row], tuple[int, int], list[threading.Event]]:
        """Return the rows of one commit, their first and last slot, and the waiting callers."""
        rows: list[Row] = []
        waiting: list[threading.Event] = []
        first = newest = NO_SLOT
        for _ in range(min(len(self._items), self.settings.commit_slots)):
            item = self._items.popleft()
            if isinstance(item, threading.Event):
                waiting.append(item)
                continue
            if isinstance(item, _Slot):
                newest = max(newest, item.record.slot)
                first = item.record.slot if first == NO_SLOT else first
            if isinstance(item, Presence):
                if self._minutes is not None:
                    self._minutes.present(item)
                continue
            rows += self._encode(item)
            time.sleep(0)  # lets the loop have the interpreter in the middle of a batch
        lost_rows = self._saver.spool.lost_rows
        shed, lost = self._shed - self._reported_shed, lost_rows - self._reported_lost
        if shed:
            self._reported_shed += shed
            self._say("store-shed", f"{plural(shed, 'record')} dropped: writer too slow")
        if lost:
            self._reported_lost += lost
            self._say("store-shed", f"{plural(lost, 'row')} dropped: spool full or unreadable")
        notes, self._notes = self._notes, []
        for note in notes:
            rows += self._encode(note)
        return rows, (first, newest), waiting

    def _sum_up(self, rows: list[Row], ending: bool = False) -> list[Row]:
        """Add rows to their minutes; return the summaries of minutes that are over."""
        if self._minutes is None:
            return []
        try:
            self._minutes.take(rows)
            return self._minutes.closed(self._wall_ns(), ending)
        except Exception as error:  # slots are worth more than their sums
            self._minutes = None
            self._say("store-error", f"no more summaries: {type(error).__name__}: {error}")
            return []

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
            self._given_up += 1
            return []

    def _say(self, kind: str, message: str) -> None:
        event = Event(self._wall_ns(), kind, message)
        self._notes.append(event)
        if self._report is not None:
            self._report(event)
