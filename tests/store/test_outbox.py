"""The outbox: numbers without gaps, whatever is killed, full, copied or beyond its bound."""

from __future__ import annotations

import json
import sqlite3
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import update
from tests.cli.commands import run as run_verb
from tests.store.conftest import STARTED_NS, record, run
from tests.store.writers import QUICK, limit_connections, wait_for

from e3pose.base.errors import InputError
from e3pose.store import Retention, Run, Store, StoreWriter, WriterSettings, schema
from e3pose.store.acknowledgements import Hubs, acknowledgements, note_taken
from e3pose.store.copying import copy_store
from e3pose.store.database import database_url, writing_engine
from e3pose.store.forgetting import Forgotten, forget
from e3pose.store.outbox import read_outbox
from e3pose.store.rows import NS
from e3pose.store.summaries import MINUTE_NS

pytestmark = pytest.mark.slow

Place = Path | str
MINUTE = 1_795_000_020_000_000_000
assert MINUTE % MINUTE_NS == 0
SUMMING = WriterSettings(commit_s=0.02, summaries=1000)


class Wall:
    """A clock that a test moves."""

    def __init__(self, now_ns: int) -> None:
        self.now_ns = now_ns

    def __call__(self) -> int:
        return self.now_ns


def write_minutes(place: Place, run: Run, count: int, settings: WriterSettings = SUMMING) -> None:
    """Write slots, one a second, of so many minutes from `MINUTE` on, and end at their end."""
    wall = Wall(MINUTE)
    with StoreWriter(place, run, settings, wall_ns=wall) as writer:
        for slot in range(60 * count):
            wall.now_ns = MINUTE + slot * NS
            writer.append(record(slot), time_ns=wall.now_ns, wait=True)
            if slot % 60 == 59:
                writer.flush()
        wall.now_ns = MINUTE + count * MINUTE_NS


def test_minutes_come_in_order_and_from_where_one_has_them(place: Place) -> None:
    write_minutes(place, run(), 3)
    found = read_outbox(place, "hall")
    assert [row["number"] for row in found.summaries] == [1, 2, 3]
    assert [row["slots"] for row in found.summaries] == [60, 60, 60]
    assert [row["time_ns"] for row in found.summaries] == [MINUTE + n * MINUTE_NS for n in range(3)]
    assert (found.newest, found.shed, found.begun_ns) == (3, 0, MINUTE)
    assert found.summaries[0]["started_ns"] == run().started_ns
    assert [row["number"] for row in read_outbox(place, "hall", after=2).summaries] == [3]
    assert [row["number"] for row in read_outbox(place, "hall", limit=1).summaries] == [1]
    assert read_outbox(place, "elsewhere").summaries == ()


def test_outbox_is_bounded_and_says_what_it_shed(place: Place) -> None:
    write_minutes(place, run(), 6, WriterSettings(commit_s=0.02, summaries=4))
    found = read_outbox(place, "hall")
    assert [row["number"] for row in found.summaries] == [3, 4, 5, 6]
    assert (found.newest, found.shed) == (6, 2)


def test_numbers_of_sites_are_their_own_and_a_minute_is_stored_once(place: Place) -> None:
    write_minutes(place, run(), 2)
    write_minutes(place, run("yard"), 1)
    write_minutes(place, run(), 2)  # the same again
    assert [row["number"] for row in read_outbox(place, "hall").summaries] == [1, 2]
    assert [row["number"] for row in read_outbox(place, "yard").summaries] == [1]
    assert read_outbox(place, "hall").newest == 2


def test_replay_makes_no_summaries(place: Place) -> None:
    write_minutes(place, run(), 2, QUICK)
    assert Store(place).rows("summaries") == []


def test_summaries_outlive_their_slots(place: Place) -> None:
    write_minutes(place, run(started_ns=MINUTE - 1), 2)
    keeping = WriterSettings(commit_s=0.02, summaries=1000, retention=Retention(max_age_s=30))
    later = Wall(MINUTE + 3600 * NS)
    with StoreWriter(place, run(started_ns=MINUTE), keeping, wall_ns=later) as writer:
        writer.append(record(0), time_ns=later.now_ns)
        wait_for(lambda: len(Store(place).rows("slots")) == 1)
    assert [row["number"] for row in read_outbox(place, "hall").summaries][:2] == [1, 2]


def test_hubs_hear_of_every_deletion_once_and_the_site_knows_which(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_minutes(place, run(), 3)
    person = Forgotten("hall", STARTED_NS, STARTED_NS, STARTED_NS, 10)
    asked = [forget(place, person)[0], forget(place, replace(person, track_id=11))[0]]
    write_minutes(place, run(started_ns=MINUTE), 2)
    forget(place, Forgotten("yard", 0, 1))
    assert [what.outbox_number for what in asked] == [4, 5]
    for size in (1, 2, 4, 9):  # however much is fetched at a time
        after, numbers, told = 0, list[int](), list[Forgotten]()
        while (got := read_outbox(place, "hall", after, size)).summaries or got.forgotten:
            numbers += [row["number"] for row in got.summaries]
            told += got.forgotten
            after = max([after, *numbers, *(what.outbox_number for what in got.forgotten)])
        assert (sorted(numbers), told, after) == ([1, 2, 3, 6, 7], asked, 7)
    assert [read_outbox(place, "hall", n).forgotten for n in (4, 5)] == [(asked[1],), ()]

    def known() -> list[tuple[tuple[str, ...], tuple[str, ...]]]:
        found = acknowledgements(place, "hall")
        assert [each.what for each in found] == asked
        return [(each.informed, each.pending) for each in found]

    assert known() == [((), ())] * 2
    hubs = Hubs(place, "hall")
    for now, (hub, after, tells) in enumerate(
        (("b", 0, True), ("a", 4, False), ("a", 9, False), ("b", 5, False), ("b", 9, True))
    ):  # one that was told nothing new is not noted again
        hubs.asked(hub, after, tells, now)
    assert known() == [(("a", "b"), ()), (("b",), ("a",))]
    monkeypatch.setattr("e3pose.store.acknowledgements.MOST_HUBS", 2)
    note_taken(place, "hall", "c", 3, 9)
    assert known() == [(("b",), ("c",))] * 2, "those that asked last"
    assert acknowledgements(place, "yard")[0].pending == ()
    lost = Hubs(Path("/nowhere/hall.db"), "hall")
    lost.asked("a", 9, False, 0)
    lost.store = place
    lost.asked("a", 9, False, 10)
    assert known()[1] == (("a",), ("c",)), "noted with a later question"


def test_copy_has_a_cursor_of_its_own(tmp_path: Path) -> None:
    write_minutes(tmp_path / "hall.db", run(), 2)
    copy_store(tmp_path / "hall.db", tmp_path / "copy.db", lambda *_: None)
    before, after = (read_outbox(tmp_path / f"{name}.db", "hall") for name in ("hall", "copy"))
    assert after.summaries == before.summaries and after.newest == before.newest
    assert after.begun_ns != before.begun_ns


def test_minutes_of_programs_that_are_killed_are_as_long_as_these_ran(tmp_path: Path) -> None:
    """In hours of crashes nothing is summed up twice or lost, and no time while nothing ran."""
    rng, wall, slot, lives = np.random.default_rng(4), Wall(MINUTE), count(), 6
    path, ran_s = tmp_path / "hall.db", 0
    for life in range(lives):
        wall.now_ns += round(rng.uniform(70, 400)) * NS
        with StoreWriter(path, run(), SUMMING, wall_ns=wall) as writer:
            writer.flush()
            seconds = round(rng.uniform(10, 200)) + 100 * (life == 0)
            for second in range(seconds + 1):
                wall.now_ns += NS * (second > 0)
                writer.append(record(next(slot), 1), time_ns=wall.now_ns, wait=True)
                if second % 4 == 0 or second == seconds:  # rows come within the grace
                    writer.flush()
            ran_s += seconds
            writer._minutes = None  # killed: its last minute is not summed up
    wall.now_ns += 100 * NS
    with StoreWriter(path, run(), SUMMING, wall_ns=wall) as writer:
        writer.flush()
    found = read_outbox(path, "hall").summaries
    begin_s = np.array([row["time_ns"] / NS for row in found])
    span_s = np.array([row["span_s"] for row in found])
    assert (np.diff(begin_s) >= span_s[:-1]).all() and span_s.max() == 60.0
    # A single slot after the last minute has no length, and is left out.
    assert 0 <= next(slot) - sum(row["slots"] for row in found) <= lives
    assert ran_s - 2 * lives < span_s.sum() <= ran_s


def test_part_of_a_minute_that_a_killed_writer_left_is_summed_up_once(tmp_path: Path) -> None:
    path, wall = tmp_path / "hall.db", Wall(MINUTE)
    for begin, end in ((0, 20), (30, 50), (52, 55), (130, 140)):
        wall.now_ns = MINUTE + begin * NS
        with StoreWriter(path, run(), SUMMING, wall_ns=wall) as writer:
            for slot in range(begin, end):
                wall.now_ns = MINUTE + slot * NS
                writer.append(record(slot), time_ns=wall.now_ns, wait=True)
                writer.flush()
            wall.now_ns += NS // 2
            if begin == 30:
                writer._minutes = None  # killed: it sums up nothing
    found = read_outbox(path, "hall").summaries
    assert [row["slots"] for row in found] == [20, 20 + 3, 10]
    assert [row["people"] for row in found] == [2.0] * 3
    assert [row["time_ns"] - MINUTE for row in found] == [0, 30 * NS, 130 * NS]


def test_full_disk_delays_summaries_and_loses_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, wall, full = tmp_path / "hall.db", Wall(MINUTE), [False]
    limit_connections(monkeypatch, lambda: f"max_page_count = {40 if full[0] else 1_000_000}")
    with StoreWriter(path, run(), SUMMING, wall_ns=wall) as writer:
        writer.append(record(0), time_ns=wall.now_ns)
        writer.flush()
        full[0] = True
        writer._saver._delivery.close()  # the next connection has no room
        for slot in range(1, 181):
            wall.now_ns = MINUTE + slot * NS
            writer.append(record(slot, 20), time_ns=wall.now_ns, wait=True)
            if slot % 30 == 0:
                writer.flush()
        assert writer.status().problem is not None
        full[0] = False
        wait_for(lambda: writer.status().problem is None)
        wall.now_ns += 10 * NS
        writer.flush()
    found = read_outbox(path, "hall").summaries
    assert [row["number"] for row in found] == [1, 2, 3, 4]
    assert sum(row["slots"] for row in found) == 181


def test_query_shows_and_writes_summaries(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "hall.db"
    write_minutes(path, run(), 2)
    assert run_verb("query", path, "--what", "summaries") == 0
    assert "slots" in capsys.readouterr().out
    written = tmp_path / "minutes.json"
    assert run_verb("query", path, "--what", "summaries", "--json", written) == 0
    rows = json.loads(written.read_text())
    assert [row["number"] for row in rows] == [1, 2]
    assert json.loads(rows[0]["faults"]) == [f"camera-lost {c}" for c in sorted(run().cameras)]


def test_damaged_summary_is_named(tmp_path: Path) -> None:
    path = tmp_path / "hall.db"
    write_minutes(path, run(), 1)
    for wrong in ("no JSON", "3", "[]", "[" * 100_000):
        with writing_engine(database_url(path)).begin() as connection:
            connection.execute(update(schema.summaries).values(zones=wrong))
        with pytest.raises(InputError, match=r"summaries: number 1: zones is no JSON"):
            read_outbox(path, "hall")
    with sqlite3.connect(path) as found:
        assert found.execute("PRAGMA integrity_check").fetchone() == ("ok",)
