"""Killed processes, full disks, locks, damage: what was acknowledged stays, nobody is stopped."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.waiting import eventually

from e3pose.errors import InputError
from e3pose.pipeline import SlotRecord
from e3pose.store import Event, Run, Store, StoreWriter, WriterSettings, database
from e3pose.store.integrity import Watch, problem_of
from e3pose.store.spool import spools_of

Records = Callable[..., SlotRecord]
Runs = Callable[..., Run]
QUICK = WriterSettings(commit_s=0.02, spool_bytes=400_000)


def wait_for(condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
    assert eventually(condition, timeout_s), "it never came to pass"


def stored_slots(path: Path) -> list[int]:
    return [row["slot"] for row in Store(path).rows("slots")]


CHILD = """
import sys
sys.path.insert(0, {tests!r})
from conftest import make_record, make_run
from e3pose.store import StoreWriter, WriterSettings
writer = StoreWriter({path!r}, make_run(), WriterSettings(commit_s=0.05))
said = -1
for slot in range(10**9):
    writer.append(make_record(slot), wait=True)
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


def test_full_disk_goes_to_the_spool_and_comes_back(
    small_disk: Path, record: Records, run: Runs
) -> None:
    told: list[Event] = []
    path = small_disk / "live.db"
    with StoreWriter(path, run(), QUICK, tell=told.append) as writer:
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
        while writer.status().trouble is None:
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
        assert any(event.kind == "store-full" for event in told)
        assert slowest_s < 0.5, "the caller never waits for the disk"
        held = stored_slots(path)
        assert len(held) < slot, "readers go on, with what there is"
        ballast.unlink()
        wait_for(lambda: writer.status().trouble is None)
        writer.append(record(slot + 100))
        assert writer.flush()
        assert writer.status().spooled == 0
    assert stored_slots(path) == list(range(slot + 101))
    kinds = [row["kind"] for row in Store(path).rows("events")]
    assert "store-full" in kinds
    assert "store-recovered" in kinds
    assert len(Store(path).query()) == 2 * (slot + 101)


def limit_connections(monkeypatch: pytest.MonkeyPatch, pragma: Callable[[], str]) -> None:
    def limited(url: str) -> object:
        from sqlalchemy import event

        engine = database.writing_engine(url)

        @event.listens_for(engine, "connect")
        def _limit(connection: sqlite3.Connection, _record: object) -> None:
            connection.execute(f"PRAGMA {pragma()}")

        return engine

    monkeypatch.setattr("e3pose.store.delivery.writing_engine", limited)


@pytest.fixture
def page_limit(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Pages that every new connection may use: a full disk for those who may not mount one."""
    pages = [2**30]
    limit_connections(monkeypatch, lambda: f"max_page_count = {pages[0]}")
    return pages


def test_spool_is_bounded_and_keeps_the_newest(
    tmp_path: Path, record: Records, run: Runs, page_limit: list[int]
) -> None:
    path = tmp_path / "live.db"
    with StoreWriter(path, run(), QUICK):
        pass
    page_limit[0] = 1
    told: list[Event] = []
    with StoreWriter(path, run(), QUICK, tell=told.append) as writer:
        (spool,) = spools_of(path)
        for slot in range(1500):
            assert writer.append(record(slot), wait=True)
        assert writer.flush()
        assert writer.status().trouble == "database or disk is full"
        assert writer.status().shed > 0
        assert spool.stat().st_size <= QUICK.spool_bytes + 100_000
        page_limit[0] = 2**30
        wait_for(lambda: writer.status().trouble is None)
        assert writer.flush()
        kept = stored_slots(path)
        assert kept[-1] == 1499
        assert kept == list(range(kept[0], 1500)), "what is left has no holes"
        assert len(kept) > 150, "at least the half that was full"
    assert any(event.kind == "store-shed" for event in told)
    assert spools_of(path) == []


def test_spool_of_a_killed_process_is_delivered_at_the_next_start(
    tmp_path: Path, record: Records, run: Runs, page_limit: list[int]
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
    damaged = spool.read_bytes()
    (tmp_path / "live.db.spool-7").write_bytes(b"no spool at all" * 10)
    page_limit[0] = 2**30
    told: list[Event] = []
    with StoreWriter(path, run("yard"), QUICK, tell=told.append) as writer:
        wait_for(lambda: not spool.exists())
        wait_for(lambda: len(told) >= 2)
    assert stored_slots(path) == list(range(20))
    assert len(Store(path).rows("slots", site="hall")) == 20, "under the run that it was of"
    assert any("20 slots" in e.message or "rows" in e.message for e in told)
    assert any("no spool that e3pose wrote" in e.message for e in told)
    assert (tmp_path / "live.db.spool-7").exists(), "what is not ours is not deleted"
    # Cut off anywhere, it is read up to there and never raises.
    from e3pose.store.spool import left_behind

    cut = tmp_path / "cut"
    for size in (len(damaged) - 1, 70_000, 66_000):
        cut.write_bytes(damaged[:size])
        found = left_behind(cut)
        assert found is not None
        assert all(name in {"slots", "poses", "events"} for rows in found[1] for name, _ in rows)


def test_lock_of_another_is_waited_out(tmp_path: Path, record: Records, run: Runs) -> None:
    path = tmp_path / "live.db"
    with StoreWriter(path, run(), QUICK) as writer:
        writer.append(record(0))
        assert writer.flush()
        other = sqlite3.connect(path, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        before_s = time.perf_counter()
        for slot in range(1, 100):
            assert writer.append(record(slot))
        assert time.perf_counter() - before_s < 5.0  # at once, however long the lock is held
        other.execute("ROLLBACK")
        other.close()
        assert writer.flush()
    assert stored_slots(path) == list(range(100))


def test_full_queue_sheds_and_says_so(tmp_path: Path, record: Records, run: Runs) -> None:
    path = tmp_path / "live.db"
    told: list[Event] = []
    settings = WriterSettings(commit_s=0.02, queue_slots=10)
    with StoreWriter(path, run(), settings, tell=told.append) as writer:
        blocker = sqlite3.connect(path, isolation_level=None)
        blocker.execute("BEGIN IMMEDIATE")
        taken = [writer.append(record(slot)) for slot in range(100)]
        assert not all(taken)
        blocker.execute("ROLLBACK")
        blocker.close()
        assert writer.flush()
        assert writer.status().shed == taken.count(False)
        writer.append(record(100))
        assert writer.flush()
    assert any(event.kind == "store-shed" for event in told)
    assert stored_slots(path) == [s for s, ok in enumerate(taken) if ok] + [100]


def test_unknown_version_is_refused_and_untouched(
    tmp_path: Path, record: Records, run: Runs
) -> None:
    path = tmp_path / "future.db"
    with StoreWriter(path, run()) as writer:
        writer.append(record(0))
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE e3pose_store SET version = 7")
    connection.close()
    before = path.read_bytes()
    for use in (lambda: StoreWriter(path, run()), lambda: Store(path).query()):
        with pytest.raises(InputError, match=r"schema version: found 7, expected 1; read it with"):
            use()
    assert path.read_bytes() == before


def test_somebody_elses_database_is_refused(tmp_path: Path, run: Runs) -> None:
    path = tmp_path / "photos.db"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE photos (name TEXT)")
    connection.close()
    for use in (lambda: StoreWriter(path, run()), lambda: Store(path).query()):
        with pytest.raises(InputError, match="found tables photos, expected a database"):
            use()
    text = tmp_path / "letter.txt"
    text.write_text("dear all")
    with pytest.raises(InputError, match="no database"):
        StoreWriter(text, run())
    assert text.read_text() == "dear all"
    with pytest.raises(InputError, match="no such file"):
        Store(tmp_path / "nothing.db").query()
    with pytest.raises(InputError, match="no folder"):
        StoreWriter(tmp_path / "no" / "where.db", run())


@pytest.mark.parametrize("place", ["head", "middle"])
def test_damaged_database_is_set_aside_and_kept(
    tmp_path: Path, record: Records, run: Runs, place: str
) -> None:
    path = tmp_path / "live.db"
    with StoreWriter(path, run(), QUICK) as writer:
        for slot in range(300):
            writer.append(record(slot), wait=True)
    content = bytearray(path.read_bytes())
    if place == "head":
        content[:100] = os.urandom(100)
    else:
        content[4096 : len(content) // 2] = os.urandom(len(content) // 2 - 4096)
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"damaged|no tables"):
        Store(path).query()
    told: list[Event] = []
    with StoreWriter(path, run(), QUICK, tell=told.append) as writer:
        writer.append(record(5))
    (aside,) = tmp_path.glob("live.db.corrupt-*Z")
    assert aside.read_bytes() == bytes(content)
    assert stored_slots(path) == [5]
    (event,) = [event for event in told if event.kind == "store-corrupt"]
    assert aside.name in event.message
    assert "a new one takes its place" in event.message


def test_damage_while_running_starts_a_new_database(
    tmp_path: Path, record: Records, run: Runs, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit_connections(monkeypatch, lambda: "cache_size = 5")  # so that pages are read again
    path = tmp_path / "live.db"
    told: list[Event] = []
    with StoreWriter(path, run(), QUICK, tell=told.append) as writer:
        for slot in range(300):
            writer.append(record(slot), wait=True)
        assert writer.flush()
        with path.open("r+b") as file:
            file.write(os.urandom(64_000))
        Path(f"{path}-wal").write_bytes(b"")
        for slot in range(300, 330):
            writer.append(record(slot), wait=True)
            time.sleep(0.01)
        wait_for(lambda: writer.status().trouble is None and writer.status().spooled == 0)
        assert writer.flush()
    assert list(tmp_path.glob("live.db.corrupt-*"))
    assert stored_slots(path)[-1] == 329
    assert any(event.kind == "store-corrupt" for event in told)


def scribble(path: Path) -> None:
    with path.open("r+b") as file:
        file.seek(path.stat().st_size // 2)
        file.write(os.urandom(40_000))


def cut_off(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2 + 7)


def write_over(path: Path) -> None:
    path.write_bytes(b"dear all, " * 1000)


def put_in_its_place(path: Path) -> None:
    (path.parent / "letter").write_bytes(b"dear all, " * 1000)
    os.replace(path.parent / "letter", path)


@pytest.mark.parametrize(
    ("harm", "check_s"),
    [(scribble, 0.1), (cut_off, 1000.0), (write_over, 1000.0), (put_in_its_place, 1000.0)],
)
def test_damage_that_no_commit_meets_is_found(
    tmp_path: Path, record: Records, run: Runs, harm: Callable[[Path], None], check_s: float
) -> None:
    path = tmp_path / "live.db"
    told: list[Event] = []
    settings = WriterSettings(commit_s=0.02, check_s=check_s)
    with StoreWriter(path, run(), settings, tell=told.append) as writer:
        for slot in range(600):
            writer.append(record(slot), wait=True)
        assert writer.flush()
        with sqlite3.connect(path) as connection:  # all of it is in the file
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        connection.close()
        wait_for(lambda: writer._watch is not None and writer._watch._thread is None)
        assert writer.status().corrupt == 0 and not told
        harm(path)
        slot = 600
        while writer.status().corrupt == 0:
            writer.append(record(slot))
            slot += 1
            time.sleep(0.01)
            assert slot < 3000, "nobody noticed"
        writer.append(record(slot))
        wait_for(lambda: writer.status().trouble is None and writer.status().spooled == 0)
        assert writer.flush()
    assert stored_slots(path)[-1] == slot
    assert len([event for event in told if event.kind == "store-corrupt"]) == 1
    (aside,) = (p for p in tmp_path.glob("live.db.corrupt-*") if p.name.endswith("Z"))
    assert problem_of(aside) and not problem_of(path)


def test_damage_is_not_held_against_the_file_that_took_its_place(
    tmp_path: Path, record: Records, run: Runs
) -> None:
    path = tmp_path / "live.db"
    path.write_bytes(b"dear all, " * 1000)
    for replaced in (False, True):
        watch = Watch(path, every_s=1000.0)
        assert watch.look() == ""
        assert watch._thread is not None
        watch._thread.join()
        if replaced:
            path.rename(tmp_path / "aside")
            with StoreWriter(path, run()) as writer:
                writer.append(record(0))
        assert watch.look() == ("" if replaced else "file is not a database")


def test_look_at_a_file_ends_in_time(tmp_path: Path, record: Records, run: Runs) -> None:
    path = tmp_path / "live.db"
    with StoreWriter(path, run()) as writer:
        writer.append(record(0))
    path.write_bytes(b"dear all, " * 1000)
    assert problem_of(path) == "file is not a database"
    assert problem_of(path, limit_s=0.0) in ("", "file is not a database")
    assert problem_of(tmp_path / "nothing.db") == ""


def test_file_that_is_moved_away_is_begun_again(tmp_path: Path, record: Records, run: Runs) -> None:
    path = tmp_path / "live.db"
    with StoreWriter(path, run(), QUICK) as writer:
        writer.append(record(0))
        assert writer.flush()
        for ending in ("", "-wal", "-shm"):
            (tmp_path / f"live.db{ending}").rename(tmp_path / f"old.db{ending}")
        writer.append(record(1))
        assert writer.flush()
        writer.append(record(2))
        assert writer.flush()
    assert stored_slots(path)[-1] == 2
    assert stored_slots(tmp_path / "old.db")[0] == 0


def test_reader_sees_only_whole_slots_while_writing(
    tmp_path: Path, record: Records, run: Runs
) -> None:
    path = tmp_path / "live.db"
    with StoreWriter(path, run(), QUICK) as writer:
        writer.append(record(0))
        assert writer.flush()
        for slot in range(1, 400):
            writer.append(record(slot), wait=True)
            if slot % 40 == 0:
                found = Store(path).query()
                slots, counts = np.unique(found.slots, return_counts=True)
                assert (counts == 2).all()
                assert slots.tolist() == list(range(len(slots)))


def test_a_folder_that_cannot_be_written_is_still_read(
    tmp_path: Path, record: Records, run: Runs
) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    folder = tmp_path / "archive"
    folder.mkdir()
    with StoreWriter(folder / "old.db", run()) as writer:
        writer.append(record(0))
    folder.chmod(0o555)
    try:
        assert len(Store(folder / "old.db").query()) == 2
    finally:
        folder.chmod(0o755)
