"""Killed processes, full disks, locks: what was acknowledged stays, and nobody is stopped."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from pathlib import Path

import pytest
from sqlalchemy.exc import DBAPIError
from tests.cases import each_case
from tests.store.conftest import record, run
from tests.store.writers import QUICK, limit_connections, stored_slots, wait_for

from e3pose.base.errors import InputError
from e3pose.model.zone_event import ZoneEvent
from e3pose.store import Event, Run, Store, StoreWriter, WriterSettings
from e3pose.store.rows import EnergyReading, Presence, Row, slot_rows
from e3pose.store.saver import Delivery
from e3pose.store.spool import MAGIC, LeftSpool, Spool, frame, spools_of
from e3pose.store.summaries import Minutes

pytestmark = pytest.mark.slow

CHILD = """
import sys
sys.path.insert(0, {tests!r})
from conftest import record, run
from e3pose.store import StoreWriter, WriterSettings
writer = StoreWriter({path!r}, run(), WriterSettings(commit_s=0.05))
said = -1
for slot in range(10**9):
    writer.append(record(slot), wait=True)
    newest = writer.status().acknowledged_slot
    if newest > said:
        said = newest
        print(newest, flush=True)
"""


def test_what_was_acknowledged_survives_kill_9(tmp_path: Path) -> None:
    path = tmp_path / "killed.db"
    code = CHILD.format(tests=str(Path(__file__).parent), path=str(path))
    child = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, bufsize=1
    )
    assert child.stdout is not None
    acknowledged = -1
    with child.stdout as lines:
        for line in lines:
            acknowledged = int(line)
            if acknowledged > 200:
                break
        child.send_signal(signal.SIGKILL)
        acknowledged = max([acknowledged, *(int(line) for line in lines)])
    assert child.wait() == -signal.SIGKILL
    slots = stored_slots(path)
    assert slots == list(range(len(slots))), "no slot is missing or there twice"
    assert len(slots) > acknowledged
    found = Store(path).query()
    assert len(found) == 2 * len(slots), "a slot has all its people or is not there"
    assert len(spools_of(path)) == 1, "the killed process had no time to remove it"
    writer = StoreWriter(path, Run("hall", "next", 5, 0.04, "s", ("nose",), ("c",)))
    writer.event(Event(6, "start", "again"))
    wait_for(lambda: len(spools_of(path)) == 1)  # that of the new process alone
    writer.close()
    assert spools_of(path) == []


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Two megabytes of a file system of its own, where that may be made."""
    place = tmp_path / "small"
    place.mkdir()
    mount = shutil.which("mount")
    if (
        mount is None
        or subprocess.run(
            [mount, "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(place)], capture_output=True
        ).returncode
    ):
        pytest.skip("file systems may not be mounted here")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def test_full_disk_goes_to_the_spool_and_comes_back(small_disk: Path) -> None:
    events: list[Event] = []
    path = small_disk / "live.db"
    with StoreWriter(path, run(), QUICK, report=events.append) as writer:
        for slot in range(50):
            writer.append(record(slot), wait=True)
        assert writer.flush()
        assert writer.status().acknowledged_slot == 49
        ballast = small_disk / "ballast"
        handle = os.open(ballast, os.O_WRONLY | os.O_CREAT)
        with pytest.raises(OSError, match="space"):
            while True:
                os.write(handle, bytes(4096))
        os.close(handle)
        slowest_s, slot = 0.0, 50
        while writer.status().problem is None:
            before_s = time.perf_counter()
            assert writer.append(record(slot))
            slowest_s = max(slowest_s, time.perf_counter() - before_s)
            slot += 1
            time.sleep(0.001)
            assert slot < 5000, "the disk never became full"
        for more in range(slot, slot + 100):
            assert writer.append(record(more))
        assert writer.flush()
        status = writer.status()
        assert status.spooled > 0
        assert status.shed == 0
        assert any(event.kind == "store-full" for event in events)
        assert slowest_s < 0.5, "the caller never waits for the disk"
        held = stored_slots(path)
        assert len(held) < slot, "readers go on, with what there is"
        ballast.unlink()
        wait_for(lambda: writer.status().problem is None)
        writer.append(record(slot + 100))
        assert writer.flush()
        assert writer.status().spooled == 0
    assert stored_slots(path) == list(range(slot + 101))
    kinds = [row["kind"] for row in Store(path).rows("events")]
    assert "store-full" in kinds
    assert "store-recovered" in kinds
    assert len(Store(path).query()) == 2 * (slot + 101)


@pytest.fixture
def page_limit(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Pages that every new connection may use: a full disk for those who may not mount one."""
    pages = [2**30]
    limit_connections(monkeypatch, lambda: f"max_page_count = {pages[0]}")
    return pages


def test_spool_is_bounded_and_keeps_the_newest(tmp_path: Path, page_limit: list[int]) -> None:
    path = tmp_path / "live.db"
    with StoreWriter(path, run(), QUICK):
        pass
    page_limit[0] = 1
    events: list[Event] = []
    with StoreWriter(path, run(), QUICK, report=events.append) as writer:
        (spool,) = spools_of(path)
        for slot in range(1500):
            assert writer.append(record(slot), wait=True)
        assert writer.flush()
        assert writer.status().problem == "database or disk is full"
        assert writer.status().shed > 0
        assert spool.stat().st_size <= QUICK.spool_bytes + 100_000
        page_limit[0] = 2**30
        wait_for(lambda: writer.status().problem is None)
        assert writer.flush()
        kept = stored_slots(path)
        assert kept[-1] == 1499
        assert kept == list(range(kept[0], 1500)), "what is left has no holes"
        assert len(kept) > 150, "at least the half that was full"
    assert any(event.kind == "store-shed" for event in events)
    assert spools_of(path) == []


def test_spool_of_a_killed_process_is_delivered_at_the_next_start(
    tmp_path: Path, page_limit: list[int]
) -> None:
    path = tmp_path / "live.db"
    page_limit[0] = 1
    with StoreWriter(path, run(), QUICK) as writer:
        for slot in range(20):
            writer.append(record(slot))
        writer.flush()
        (spool,) = spools_of(path)
        copy = tmp_path / "left"
        shutil.copy(spool, copy)  # as a kill would leave it
    shutil.move(copy, spool)
    (tmp_path / "live.db.spool-7").write_bytes(b"no spool at all" * 10)
    page_limit[0] = 2**30
    events: list[Event] = []
    with StoreWriter(path, run("yard"), QUICK, report=events.append) as writer:
        wait_for(lambda: not spool.exists())
        wait_for(lambda: len(events) >= 2)
    assert stored_slots(path) == list(range(20))
    assert len(Store(path).rows("slots", site="hall")) == 20, "under the run that it was of"
    assert any("20 slots" in e.message or "rows" in e.message for e in events)
    assert any("no spool that e3pose wrote" in e.message for e in events)
    assert (tmp_path / "live.db.spool-7").exists(), "what is not ours is not deleted"


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock that a commit needs."""
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        yield
        other.execute("ROLLBACK")


def test_flood_of_events_leaves_room_for_slots(tmp_path: Path) -> None:
    path = tmp_path / "live.db"
    settings = WriterSettings(commit_s=0.02, queue_slots=100)
    with StoreWriter(path, run(), settings) as writer:
        with locked(path):
            time.sleep(0.1)  # the thread waits for the lock
            taken = [writer.event(Event(1, "control", "again")) for _ in range(10_000)]
            assert taken.count(True) < 400  # those that the thread took, and half the queue
            assert all(writer.append(record(slot)) for slot in range(40))
        assert writer.flush()
    assert stored_slots(path) == list(range(40))


def test_full_queue_sheds_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "live.db"
    events: list[Event] = []
    settings = WriterSettings(commit_s=0.02, queue_slots=10)
    with StoreWriter(path, run(), settings, report=events.append) as writer:
        with locked(path):
            taken = [writer.append(record(slot)) for slot in range(100)]
            assert not all(taken)
            begun_s = time.monotonic()
            others = [
                writer.present(Presence(1, {"lying": 1.0})),
                writer.energy(EnergyReading(1, "cam0", 2.0, 0.5, "measured: USB")),
                writer.zone(ZoneEvent("enter", "bed", 1, 1, 0.0, 1, 1)),
            ]
            assert not any(others), "they wait for no room either"
            assert time.monotonic() - begun_s < 5.0  # that of the lock
        assert writer.flush()
        assert writer.status().shed == taken.count(False) + 3
        writer.append(record(100))
        assert writer.flush()
    assert any(event.kind == "store-shed" for event in events)
    assert stored_slots(path) == [s for s, ok in enumerate(taken) if ok] + [100]


def test_sums_that_fail_cost_no_slot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_self: Minutes, _rows: list[Row]) -> None:
        raise ZeroDivisionError("no slots")

    path = tmp_path / "live.db"
    events: list[Event] = []
    monkeypatch.setattr(Minutes, "take", broken)
    settings = WriterSettings(commit_s=0.02, summaries=60)
    with StoreWriter(path, run(), settings, report=events.append) as writer:
        for slot in range(20):
            writer.append(record(slot))
            assert writer.flush()
    assert stored_slots(path) == list(range(20))
    said = [event for event in events if "no more summaries" in event.message]
    assert len(said) == 1 and "no slots" in said[0].message, events


@pytest.mark.parametrize(
    "error", [OSError("gone"), DBAPIError("close", None, sqlite3.OperationalError("gone"))]
)
def test_connection_that_cannot_be_closed_is_replaced(tmp_path: Path, error: Exception) -> None:
    path = tmp_path / "live.db"
    delivery = Delivery(f"sqlite:///{path}")
    assert delivery.commit(slot_rows(record(0), 0, None), run()) == 0
    held = delivery._connection
    assert held is not None

    def fails() -> None:
        raise error

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(held, "close", fails)
        delivery.close()
    too_late = ("events", asdict(Event(2**70, "control", "again")) | {"number": 1})
    assert delivery.commit([*slot_rows(record(1), 0, None), too_late], run()) == 1
    delivery.close()
    assert stored_slots(path) == [0, 1]


ROWS: list[Row] = [("events", {"number": number}) for number in range(30)]


def test_spool_gives_back_what_it_was_given_in_order(tmp_path: Path) -> None:
    for path in (tmp_path / "live.db.spool-1", None):
        spool = Spool(run(), path, 20_000)
        given = []
        for number in range(600):  # both halves are used in turn
            spool.add([("events", {"number": number})])
            if number % 3:
                given += [row["number"] for _, row in spool.oldest()]
                spool.drop()
        while rows := spool.oldest():
            given += [row["number"] for _, row in rows]
            spool.drop()
        assert given == list(range(600)) and spool.lost_rows == 0 and len(spool) == 0
        assert spool.oldest() == []
        spool.close(keep=False)


@each_case("place", range(115_600, 117_400, 97))
def test_damage_of_a_spool_costs_the_rows_that_it_hits_alone(tmp_path: Path, place: int) -> None:
    path = tmp_path / "live.db.spool-1"
    spool = Spool(run(), path, 100_000)
    for row in ROWS * 3:
        spool.add([row])
    spool.close(keep=True)
    content = bytearray(path.read_bytes())
    content[place] ^= 0x10
    path.write_bytes(content)
    left = LeftSpool(path)
    found = list(left.frames())
    left.close()
    assert left.run == run()
    assert found.count(None) >= 1
    readable = [row for rows in found if rows is not None for row in rows]
    assert all(row in ROWS for row in readable)


def test_a_spool_with_a_deeply_nested_head_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "live.db.spool-1"
    path.write_bytes(MAGIC + frame(b"\x81\xa1x" + b"\x91" * 20_000 + b"\x00"))
    with pytest.raises(InputError, match="found a spool of another version"):
        LeftSpool(path)


@each_case("kept", [0, 10, 30, 60_000, 66_000, 115_600, 120_000])
def test_spool_that_was_cut_off_is_read_up_to_there(tmp_path: Path, kept: int) -> None:
    path = tmp_path / "live.db.spool-1"
    spool = Spool(run(), path, 100_000)
    for _ in range(80):
        spool.add(ROWS)
    spool.close(keep=True)
    os.truncate(path, kept)
    try:
        left = LeftSpool(path)
    except InputError as error:
        assert kept < 100 and str(path) in str(error)
        return
    found = list(left.frames())
    left.close()
    assert found[-1] is None, "it is said that some is missing"
    assert all(rows == ROWS for rows in found if rows is not None)


def test_damaged_spool_is_kept_and_what_can_be_read_is_stored(tmp_path: Path) -> None:
    path = tmp_path / "live.db"
    spool = Spool(run("yard"), tmp_path / "live.db.spool-1", 1_000_000)
    for slot in range(20):
        spool.add(slot_rows(record(slot), slot))
    spool.close(keep=True)
    content = bytearray((tmp_path / "live.db.spool-1").read_bytes())
    content[570_000] ^= 0x10
    (tmp_path / "live.db.spool-1").write_bytes(content)
    events: list[Event] = []
    with StoreWriter(path, run(), QUICK, report=events.append):
        wait_for(lambda: len(events) > 0)
    (event,) = events
    aside = tmp_path / "live.db.damaged-spool-1"
    assert event.kind == "store-adopted" and str(aside) in event.message
    assert "recovered 57 rows" in event.message and "1 part of it cannot be read" in event.message
    assert len(stored_slots(path)) == 19
    assert aside.read_bytes() == bytes(content) and spools_of(path) == []


def test_disk_of_the_spool_that_fails_leaves_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "live.db.spool-1"
    spool = Spool(run(), path, 100_000)
    spool.add(ROWS[:10])

    def refused(*_: object) -> int:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(os, "pwrite", refused)
    spool.add(ROWS[10:])
    assert not spool.in_file and spool.lost_rows == 0 and len(spool) == 30
    assert spool.oldest() == ROWS[:10]
    spool.drop()
    assert spool.oldest() == ROWS[10:]
    assert path.exists(), "for the next start"


def test_disk_that_turns_read_only_goes_to_memory_and_comes_back(small_disk: Path) -> None:
    events: list[Event] = []
    path = small_disk / "live.db"
    with StoreWriter(path, run(), QUICK, report=events.append) as writer:
        writer.append(record(0))
        assert writer.flush()
        writer._saver._delivery.close()
        writer._saver.spool.close(keep=True)  # what is open for writing keeps a disk from it
        mounted = ["mount", "-o", "remount,ro", str(small_disk)]
        if subprocess.run(mounted, capture_output=True).returncode:
            pytest.skip("the disk cannot be made read-only")
        for slot in range(1, 50):
            assert writer.append(record(slot))
        assert writer.flush()
        status = writer.status()
        assert status.problem and status.shed == 0
        assert [event.kind for event in events] == ["store-trouble"]
        assert "spooling to memory" in events[0].message
        subprocess.run(["mount", "-o", "remount,rw", str(small_disk)], check=True)
        wait_for(lambda: writer.status().problem is None)
    assert stored_slots(path) == list(range(50))
