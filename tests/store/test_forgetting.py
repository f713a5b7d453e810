"""Days and people are deleted from every kind of store, also what comes late."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from tests.output.archive.days import BEGIN, DAY, FIRST_DAY, HOUR, PEOPLE, SECOND_DAY, fill
from tests.store.conftest import record, run
from tests.store.writers import wait_for

from e3pose.base.errors import InputError
from e3pose.store import Store, StoreWriter
from e3pose.store.forgetting import Forgotten, day_of, forget, left, of_day
from e3pose.store.rows import slot_rows
from e3pose.store.spool import Spool, spools_of

pytestmark = pytest.mark.slow

Place = Path | str
PERSON = Forgotten("hall", BEGIN, BEGIN, BEGIN, PEOPLE[0])


def test_day_goes_and_its_neighbours_stay(place: Place) -> None:
    fill(place, range(22, 50))  # the end of one, a whole one, the beginning of a third
    day = of_day("hall", "2026-11-20")
    before = left(place, day)
    assert before == 24 * (60 + 120 + 2)
    what, rows = forget(place, day)
    assert (what.number, rows, left(place, day)) == (1, before, 0)
    slots = [row["slot"] for row in Store(place).rows("slots")]
    assert slots == [*range(22 * 60, 24 * 60), *range(48 * 60, 50 * 60)]
    assert len(Store(place).query()) == 2 * len(slots)
    assert forget(place, day) == (what, 0), "asked for twice is one request"


def test_tracks_end_where_what_is_left_of_each_does(place: Place) -> None:
    with StoreWriter(place, run("hall", BEGIN)) as writer:
        for hour in range(20, 52):  # the second person leaves in the deleted day
            people = 2 if hour < 30 else 1
            writer.append(record(hour, people), time_ns=BEGIN + hour * HOUR, wait=True)
        assert writer.flush(30.0)
    forget(place, of_day("hall", "2026-11-20"))
    columns = ("track_id", "first_slot", "last_slot", "first_ns", "last_ns")
    assert [[row[name] for name in columns] for row in Store(place).rows("tracks")] == [
        [PEOPLE[0], 20, 51, BEGIN + 20 * HOUR, BEGIN + 51 * HOUR],
        [PEOPLE[1], 20, 23, BEGIN + 20 * HOUR, BEGIN + 23 * HOUR],
    ]


def test_person_goes_and_the_day_stays(place: Place) -> None:
    fill(place, range(3))
    assert forget(place, PERSON)[1] == 180 + 1 + 3
    assert left(place, PERSON) == 0
    assert {*Store(place).query().people.track_ids.tolist()} == {PEOPLE[1]}
    assert len(Store(place).rows("slots")) == 180
    assert [row["track_id"] for row in Store(place).rows("events")] == [PEOPLE[1]] * 3


def test_whole_runs_go_with_their_last_day_and_writing_goes_on(place: Place) -> None:
    fill(place, range(1))
    with StoreWriter(place, run("hall", BEGIN + 2 * DAY)) as writer:
        writer.append(record(0), time_ns=BEGIN + 2 * DAY)
        assert writer.flush()
        forget(place, of_day("hall", FIRST_DAY))
        writer.append(record(1), time_ns=BEGIN + 2 * DAY + HOUR)
        assert writer.flush() and writer.status().problem is None
    assert [one.run.started_ns for one in Store(place).runs()] == [BEGIN + 2 * DAY]
    assert len(Store(place).rows("slots")) == 2


def test_rows_that_a_killed_edge_left_are_not_brought_back(tmp_path: Path) -> None:
    path, hall = tmp_path / "hall.db", run("hall", BEGIN)
    fill(path, range(1))
    spool = Spool(hall, tmp_path / "elsewhere", 400_000)
    for slot, time_ns in ((60, BEGIN + HOUR), (61, BEGIN + DAY)):
        spool.add(slot_rows(record(slot), time_ns))
    spool.close(keep=True)
    shutil.copy(tmp_path / "elsewhere", tmp_path / "hall.db.spool-1")
    with pytest.raises(InputError, match="rows of a killed edge"):
        forget(path, of_day("hall", FIRST_DAY))
    (tmp_path / "hall.db.spool-1").unlink()
    forget(path, of_day("hall", FIRST_DAY))
    forget(path, PERSON)
    shutil.copy(tmp_path / "elsewhere", tmp_path / "hall.db.spool-1")
    with StoreWriter(path, hall):
        wait_for(lambda: len(spools_of(path)) == 1)
    found = Store(path).query()
    assert list(zip(found.slots, found.people.track_ids, strict=True)) == [(61, PEOPLE[1])]


def test_archives_can_delete_whole_days_and_people() -> None:
    day = of_day("hall", "2026-11-20")
    assert (day.number, day.outbox_number) == (0, 0), "neither stored nor heard of"
    assert day.whole_day and PERSON.whole_day and day.day == "2026-11-20"
    assert [day_of(BEGIN + n) for n in (-1, 0, DAY)] == ["2026-11-18", FIRST_DAY, SECOND_DAY]
    assert not replace(day, end_ns=day.end_ns - 1).whole_day
    assert not replace(day, start_ns=day.start_ns + 1, end_ns=day.end_ns + 1).whole_day


def test_no_day_is_told() -> None:
    for day in ("2026-02-30", "yesterday", "20261120", ""):
        with pytest.raises(InputError, match="a day such as 2026-11-25"):
            of_day("hall", day)
