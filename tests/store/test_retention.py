"""What is removed is the oldest, a little at a time, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case
from tests.manual_clock import ManualClock
from tests.store.conftest import STARTED_NS, record, run

from e3pose.base.errors import InputError
from e3pose.base.quantities import age_s, size_bytes
from e3pose.store import EnergyReading, Event, Retention, Run, Store, StoreWriter, WriterSettings
from e3pose.store.retention import BATCH_SLOTS
from e3pose.store.rows import Row, slot_rows
from e3pose.store.saver import Delivery

NS = 10**9


def fill(path: Path, run: Run, slots: range) -> None:
    with StoreWriter(path, run, WriterSettings(commit_s=0.02)) as writer:
        for slot in slots:
            writer.append(record(slot), wait=True)


def test_old_slots_go_and_newer_ones_stay(tmp_path: Path) -> None:
    path = tmp_path / "live.db"
    fill(path, run(), range(1000))
    with StoreWriter(path, run()) as writer:
        for second in (1, 39):
            writer.event(Event(STARTED_NS + second * NS, "said", str(second)))
            writer.energy(EnergyReading(STARTED_NS + second * NS, "north", 1.0, 1.0, "m"))
    delivery = Delivery(f"sqlite:///{path}")
    now_ns = STARTED_NS + 40 * NS  # just after the last slot
    keep = Retention(max_age_s=10.0)
    delivery.trim(keep, now_ns)
    assert Store(path).rows("slots")[0]["slot"] == BATCH_SLOTS, "one small batch a time"
    for _ in range(10):
        delivery.trim(keep, now_ns)
    delivery.close()
    slots = [row["slot"] for row in Store(path).rows("slots")]
    assert slots == list(range(750, 1000))
    found = Store(path).query()
    assert sorted(set(found.slots.tolist())) == slots
    assert [row["message"] for row in Store(path).rows("events")] == ["39"]
    assert len(Store(path).rows("energy")) == 1


def test_newest_slot_stays_however_old(tmp_path: Path) -> None:
    path = tmp_path / "live.db"
    fill(path, run(), range(5))
    delivery = Delivery(f"sqlite:///{path}")
    for _ in range(3):
        delivery.trim(Retention(max_age_s=1.0), STARTED_NS + 10**6 * NS)
    delivery.close()
    assert [row["slot"] for row in Store(path).rows("slots")] == [4]
    assert len(Store(path).runs()) == 1


def test_runs_and_tracks_of_which_nothing_is_left_go(tmp_path: Path) -> None:
    path = tmp_path / "live.db"
    fill(path, run(), range(50))
    later = run("hall", STARTED_NS + 1000 * NS)
    fill(path, later, range(50))
    delivery = Delivery(f"sqlite:///{path}")
    for _ in range(3):
        delivery.trim(Retention(max_age_s=500.0), STARTED_NS + 1001 * NS)
    delivery.close()
    (left,) = Store(path).runs()
    assert left.run.started_ns == later.started_ns
    assert {row["run_id"] for row in Store(path).rows("tracks")} == {left.run_id}
    assert len(Store(path).rows("slots")) == 50


def test_tracks_are_those_of_the_slots_that_are_kept(tmp_path: Path) -> None:
    """For half an hour somebody comes and somebody goes in each slot."""
    path, kept_s, clock = tmp_path / "live.db", 300, ManualClock(STARTED_NS)
    delivery, keep = Delivery(f"sqlite:///{path}"), Retention(max_age_s=kept_s)
    for minute in range(30):
        rows = list[Row]()
        for slot in range(60 * minute, 60 * minute + 60):  # one a second
            made = record(slot, 3)
            people = replace(made.people, track_ids=slot + np.array([0, 1, 500]))
            there = replace(made, people=people)
            rows += slot_rows(there, clock.now_ns())
            clock.advance(1.0)
        delivery.commit(rows, run())
        delivery.trim(keep, clock.now_ns())
        store, newest = Store(path), 60 * minute + 59
        first = max(newest + 1 - kept_s, 0)
        assert [row["slot"] for row in store.rows("slots")] == [*range(first, newest + 1)]
        seen = {
            track for slot in range(first, newest + 1) for track in (slot, slot + 1, slot + 500)
        }
        assert {row["track_id"] for row in store.rows("tracks")} == seen
    delivery.close()


def test_file_gives_back_the_room_of_what_is_no_longer_kept(tmp_path: Path) -> None:
    """Whoever keeps an hour in place of a year gets the disk back, a little with each commit."""
    path = tmp_path / "live.db"
    delivery = Delivery(f"sqlite:///{path}")
    pose = next(row for table, row in slot_rows(record(0), STARTED_NS) if table == "poses")
    large = {**pose, "sigma_m": bytes(2**20)}
    delivery.commit([("poses", {**large, "track_id": track}) for track in range(40)], run())
    later_ns = STARTED_NS + 4000 * NS
    for slot, time_ns in enumerate((STARTED_NS, later_ns)):
        delivery.commit(slot_rows(record(slot), time_ns), run())
    delivery.close()
    sizes = [path.stat().st_size]
    for _ in range(30):
        delivery.trim(Retention(max_age_s=3600.0), later_ns)
        delivery.close()  # the log reaches the file
        sizes.append(path.stat().st_size)
    assert sizes[0] > 40 * 2**20
    assert -np.diff(sizes).min() < 4 * 2**20, "no commit waits for all of it"
    spare = 17 * 2**20  # for the next slots
    assert sizes[-1] < spare
    assert sizes[-1] == sizes[-10] > spare / 2


def test_size_is_kept_by_a_running_writer(tmp_path: Path) -> None:
    path = tmp_path / "live.db"
    settings = WriterSettings(commit_s=0.01, commit_slots=64, retention=Retention(max_bytes=10**6))
    with StoreWriter(path, run(), settings) as writer:
        for slot in range(4000):
            writer.append(record(slot), wait=True)
        assert writer.flush()
    slots = [row["slot"] for row in Store(path).rows("slots")]
    assert slots[-1] == 3999
    assert slots == list(range(slots[0], 4000))
    assert 300 < len(slots) < 2500, "the newest that fit"
    assert path.stat().st_size < 1.6 * 10**6
    (first,) = {row["first_slot"] for row in Store(path).rows("tracks")}
    assert first == 0, "the time of arrival is kept as long as the person is present"


@each_case(
    ("read", "words", "value"),
    [
        (age_s, "30d", 30 * 86400), (age_s, "12h", 43200), (age_s, "90 min", 5400),
        (age_s, "2w", 14 * 86400), (age_s, "1.5s", 1.5),
        *((age_s, words, None) for words in ("30", "d", "-3d", "0d", "3 months", "20GB")),
        (size_bytes, "20GB", 20 * 10**9), (size_bytes, "500 MB", 5 * 10**8),
        (size_bytes, "0.5tb", 5 * 10**11),
        *((size_bytes, words, None) for words in ("20", "GB", "-3GB", "10KB", "1d")),
    ],
)  # fmt: skip
def test_ages_and_sizes(read: Callable[[str], float], words: str, value: float | None) -> None:
    if value is None:
        with pytest.raises(InputError, match=r"found .*expected"):
            read(words)
    else:
        assert read(words) == value
