"""Damaged, foreign, cut off or moved databases: set aside, reported and recreated."""

from __future__ import annotations

import os
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import text
from tests.cases import each_case
from tests.store.conftest import record, run
from tests.store.writers import QUICK, limit_connections, stored_slots, wait_for

from e3pose.base.errors import InputError
from e3pose.store import Event, Store, StoreWriter, WriterSettings
from e3pose.store.database import database_url, open_checked, refusal_of, writing_engine
from e3pose.store.integrity import IntegrityWatch, problem_of

pytestmark = pytest.mark.slow


def test_somebody_elses_database_is_refused(place: Path | str, tmp_path: Path) -> None:
    with writing_engine(database_url(place)).begin() as connection:
        connection.execute(text("CREATE TABLE photos (name TEXT)"))
    for use in (lambda: StoreWriter(place, run()), lambda: Store(place).query()):
        with pytest.raises(InputError, match="found tables photos, expected a database"):
            use()
    letter = tmp_path / "letter.txt"
    letter.write_text("dear all")
    with pytest.raises(InputError, match="no database"):
        StoreWriter(letter, run())
    assert letter.read_text() == "dear all"
    with pytest.raises(InputError, match="no such file"):
        Store(tmp_path / "nothing.db").query()
    with pytest.raises(InputError, match="no folder"):
        StoreWriter(tmp_path / "no" / "where.db", run())


@pytest.mark.parametrize("place", ["head", "middle"])
def test_damaged_database_is_set_aside_and_kept(tmp_path: Path, place: str) -> None:
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
    reported: list[Event] = []
    with StoreWriter(path, run(), QUICK, report=reported.append) as writer:
        writer.append(record(5))
    (aside,) = tmp_path.glob("live.db.corrupt-*Z")
    assert aside.read_bytes() == bytes(content)
    assert stored_slots(path) == [5]
    (event,) = [event for event in reported if event.kind == "store-corrupt"]
    assert aside.name in event.message
    assert "a new one takes its place" in event.message


def test_damage_while_running_starts_a_new_database(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit_connections(monkeypatch, lambda: "cache_size = 5")  # so that pages are read again
    path, checked = tmp_path / "live.db", list[str]()
    reported: list[Event] = []

    def check(url: str) -> list[tuple[str, str]]:
        checked.append(url)
        return open_checked(url)

    monkeypatch.setattr("e3pose.store.saver.open_checked", check)
    with StoreWriter(path, run(), QUICK, report=reported.append) as writer:
        for slot in range(300):
            writer.append(record(slot), wait=True)
        assert writer.flush()
        assert len(checked) == 1, "not once a commit"
        with path.open("r+b") as file:
            file.write(os.urandom(64_000))
        Path(f"{path}-wal").write_bytes(b"")
        for slot in range(300, 330):
            writer.append(record(slot), wait=True)
            time.sleep(0.01)
        wait_for(lambda: writer.status().problem is None and writer.status().spooled == 0)
        assert writer.flush()
    assert list(tmp_path.glob("live.db.corrupt-*"))
    held = writer.status()
    assert stored_slots(path) == [*range(held.first_slot, held.acknowledged_slot + 1)]
    assert held.first_slot >= 300 and held.acknowledged_slot == 329
    assert len(checked) > 1
    assert any(event.kind == "store-corrupt" for event in reported)


def test_reasons_go_on_in_a_sentence() -> None:
    assert refusal_of(OSError(28, "No space left on device")) == "no space left on device"
    assert refusal_of(sqlite3.OperationalError("no such table: Slots")) == "no such table: Slots"


def scribble(path: Path) -> None:
    """Write over the page of a table that no commit touches."""
    with closing(sqlite3.connect(path)) as connection:
        sql = "SELECT rootpage, (SELECT page_size FROM pragma_page_size) FROM sqlite_schema"
        page, size = connection.execute(f"{sql} WHERE name = 'clips'").fetchone()
    with path.open("r+b") as file:
        file.seek((page - 1) * size)
        file.write(os.urandom(size))


def cut_off(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2 + 7)


def write_over(path: Path) -> None:
    path.write_bytes(b"dear all, " * 1000)


def put_in_its_place(path: Path) -> None:
    (path.parent / "letter").write_bytes(b"dear all, " * 1000)
    os.replace(path.parent / "letter", path)


@each_case(
    ("harm", "check_s"),
    [(scribble, 0.1), (cut_off, 1000.0), (write_over, 1000.0), (put_in_its_place, 1000.0)],
)
def test_damage_that_no_commit_meets_is_found(
    tmp_path: Path, harm: Callable[[Path], None], check_s: float
) -> None:
    path = tmp_path / "live.db"
    reported: list[Event] = []
    settings = WriterSettings(commit_s=0.02, check_s=check_s)
    with StoreWriter(path, run(), settings, report=reported.append) as writer:
        for slot in range(200):
            writer.append(record(slot), wait=True)
        assert writer.flush()
        with sqlite3.connect(path) as connection:  # all of it is in the file
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        connection.close()
        watch = writer._saver._watch
        wait_for(lambda: watch is not None and watch._thread is None)
        assert writer.status().corrupt == 0 and not reported
        harm(path)
        slot = 200
        while writer.status().corrupt == 0:
            writer.append(record(slot))
            slot += 1
            time.sleep(0.01)
            assert slot < 3000, "nobody noticed"
        writer.append(record(slot))
        wait_for(lambda: writer.status().problem is None and writer.status().spooled == 0)
        assert writer.flush()
    held = writer.status()
    assert stored_slots(path) == [*range(held.first_slot, slot + 1)]
    assert held.first_slot >= 200 and held.acknowledged_slot == slot
    assert len([event for event in reported if event.kind == "store-corrupt"]) == 1
    (aside,) = (p for p in tmp_path.glob("live.db.corrupt-*") if p.name.endswith("Z"))
    assert problem_of(aside) and not problem_of(path)


def test_damage_is_not_held_against_the_file_that_took_its_place(tmp_path: Path) -> None:
    path = tmp_path / "live.db"
    path.write_bytes(b"dear all, " * 1000)
    for replaced in (False, True):
        watch = IntegrityWatch(path, every_s=1000.0)
        assert watch.check() == ""
        assert watch._thread is not None
        watch._thread.join()
        if replaced:
            path.rename(tmp_path / "aside")
            with StoreWriter(path, run()) as writer:
                writer.append(record(0))
        assert watch.check() == ("" if replaced else "file is not a database")


def test_check_of_a_file_ends_in_time(tmp_path: Path) -> None:
    path = tmp_path / "live.db"
    with StoreWriter(path, run()) as writer:
        writer.append(record(0))
    path.write_bytes(b"dear all, " * 1000)
    assert problem_of(path) == "file is not a database"
    assert problem_of(path, limit_s=0.0) in ("", "file is not a database")
    assert problem_of(tmp_path / "nothing.db") == ""


def test_file_that_is_moved_away_is_begun_again(tmp_path: Path) -> None:
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


def test_reader_sees_only_whole_slots_while_writing(tmp_path: Path) -> None:
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


def test_a_folder_that_cannot_be_written_is_still_read(tmp_path: Path) -> None:
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
