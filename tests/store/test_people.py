"""Names of people in a store; who is forgotten is in none of its bytes, nor in exports."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest
from sqlalchemy import text
from tests.cases import each_case
from tests.cli.commands import run as verb
from tests.store.conftest import STARTED_NS, record, run

from e3pose.base.errors import InputError
from e3pose.model.zone_event import ZoneEvent
from e3pose.store import Event, Store, StoreWriter
from e3pose.store.database import database_url, writing_engine
from e3pose.store.forgetting import forget
from e3pose.store.people import (
    OF_PEOPLE,
    Called,
    kept_of,
    names_of,
    people_of,
    requests_of,
    set_colour,
    set_name,
    tracks_of,
    write_anew,
)

Place = Path | str
SLOTS = 60
PERSON, OTHER = 10, 11


def write(place: Place) -> None:
    """Store a run of two people, with an event and a zone event of each."""
    with StoreWriter(place, run()) as writer:
        for slot in range(SLOTS):
            writer.append(record(slot), time_ns=STARTED_NS + slot * 40_000_000, wait=True)
        for track in (PERSON, OTHER):
            said = f"Person {track} fell"
            writer.event(Event(STARTED_NS + track, "fell-here", said, track_id=track, zone="bed"))
            writer.zone(ZoneEvent("enter", "bed", track, 1, 0.0, 3, STARTED_NS + track))
        assert writer.flush(30.0)


@pytest.fixture
def stored(place: Place) -> Place:
    write(place)
    return place


def test_people_are_named_renamed_and_merged(stored: Place) -> None:
    assert [(one.name, one.tracks) for one in people_of(stored)] == [
        (None, ((1, PERSON),)), (None, ((1, OTHER),)),
    ]  # fmt: skip
    assert set_name(stored, tracks_of(stored, "10"), "Ada") == 1
    assert set_name(stored, tracks_of(stored, "Ada"), "Ada L.") == 1
    assert set_name(stored, tracks_of(stored, "11"), "Ada L.") == 1
    (person,) = people_of(stored)
    assert person.name == "Ada L." and person.tracks == ((1, PERSON), (1, OTHER))
    assert [row["name"] for row in Store(stored).rows("tracks")] == ["Ada L."] * 2
    with pytest.raises(InputError, match=r"a track, or one of Ada L\."):
        tracks_of(stored, "Bob")
    with pytest.raises(InputError, match="track 99 of run 1"):
        set_name(stored, tracks_of(stored, "99"), "Bob")
    for wrong in ("", " ", "7", "x" * 101, "A\x1b[31m", "A\nB"):
        with pytest.raises(InputError, match="not only digits"):
            set_name(stored, person.tracks, wrong)


def test_a_colour_is_of_the_person_also_of_tracks_that_get_the_name_later(stored: Place) -> None:
    set_name(stored, ((1, PERSON),), "Ada")
    assert set_colour(stored, tracks_of(stored, "Ada"), "orange") == 1
    assert {one.name: one.colour for one in people_of(stored)} == {"Ada": "orange", None: None}
    set_name(stored, ((1, OTHER),), "Ada")
    assert [row["colour"] for row in Store(stored).rows("tracks")] == ["orange"] * 2
    set_name(stored, ((1, OTHER),), None)
    assert [one.name for one in people_of(stored, named=True)] == ["Ada"]
    set_colour(stored, ((1, PERSON), (1, OTHER)), None)
    assert {one.colour for one in people_of(stored)} == {None}
    with pytest.raises(InputError, match="colour: found 'red', expected one of blue, orange"):
        set_colour(stored, ((1, PERSON),), "red")
    with pytest.raises(InputError, match="track 99 of run 1"):
        set_colour(stored, ((1, 99),), "blue")


def test_names_of_the_running_run_are_found_by_its_start(stored: Place) -> None:
    assert names_of(stored, "hall", STARTED_NS)[:2] == (1, {})
    set_name(stored, ((1, PERSON),), "Ada")
    set_colour(stored, ((1, OTHER),), "gold")
    number, called, _ = names_of(stored, "hall", STARTED_NS)
    assert (number, called) == (1, {PERSON: Called("Ada", None), OTHER: Called(None, "gold")})
    assert names_of(stored, "hall", STARTED_NS + 1) == (None, {}, {})
    with StoreWriter(stored, run()) as writer:  # the second has left an hour ago
        writer.append(record(SLOTS, 1), time_ns=STARTED_NS + 3_600_000_000_000, wait=True)
        assert writer.flush(30.0)
    _, later, came_ns = names_of(stored, "hall", STARTED_NS)
    assert later == called and came_ns == {PERSON: STARTED_NS}
    assert names_of(stored, "elsewhere", STARTED_NS) == (None, {}, {})


def test_name_stays_while_the_track_goes_on(stored: Place) -> None:
    set_name(stored, ((1, PERSON),), "Ada")
    with StoreWriter(stored, run()) as writer:  # the edge started again, in the same run
        writer.append(record(SLOTS), time_ns=STARTED_NS + SLOTS * 40_000_000, wait=True)
        assert writer.flush(30.0)
    (ada,) = [one for one in people_of(stored) if one.name == "Ada"]
    assert ada.last_ns == STARTED_NS + SLOTS * 40_000_000


def files_of(place: str) -> set[int]:
    """Return the numbers of the files in which a server has tables with people."""
    with writing_engine(database_url(place)).connect() as connection:
        asked = (text(f"SELECT pg_relation_filenode('{table.name}')") for table in OF_PEOPLE)
        return {connection.execute(each).scalar_one() for each in asked}


def test_who_is_forgotten_is_gone_and_the_others_are_not(stored: Place) -> None:
    set_name(stored, ((1, PERSON),), "Ada")
    files = files_of(stored) if isinstance(stored, str) else set()
    before = kept_of(stored, ((1, OTHER),))
    removed = kept_of(stored, ((1, PERSON),))
    assert removed == {"poses": SLOTS, "tracks": 1, "events": 1, "zones": 1}
    (asked,) = requests_of(stored, ((1, PERSON),))
    assert forget(stored, asked)[1] == SLOTS + 3
    write_anew(stored)
    assert not isinstance(stored, str) or not files & files_of(stored), "no page has what it had"
    assert kept_of(stored, ((1, PERSON),)) == dict.fromkeys(removed, 0)
    assert kept_of(stored, ((1, OTHER),)) == before == removed
    assert len(Store(stored).rows("slots")) == SLOTS
    assert forget(stored, asked)[1] == 0


@each_case("form", ["csv", "json", "parquet"])
def test_no_byte_of_who_is_forgotten_is_left(
    tmp_path: Path, form: str, capsys: pytest.CaptureFixture[str]
) -> None:
    store, copy, export = tmp_path / "hall.db", tmp_path / "copy.db", tmp_path / f"poses.{form}"
    write(store)
    set_name(store, ((1, PERSON),), "Ada Lovelace")
    poses = Store(store).query(track=PERSON).people.joints_m.astype("<f4")
    assert verb("store", "copy", store, copy) == 0
    words = ("query", store, "--json", export) if form == "json" else ("export", store, export)
    assert verb(*words, *(() if form == "json" else ("--what", "poses"))) == 0

    def left() -> list[str]:
        files = [path for path in tmp_path.iterdir() if path.suffix != f".{form}"]
        content = b"".join(path.read_bytes() for path in files)
        marks = [b"Ada Lovelace", b"Person 10 fell"]
        marks += [pose[:3].tobytes() for pose in poses]  # (slot, 0, joint): nobody else's
        return [str(mark) for mark in marks if mark in content]

    assert len(left()) == 2 + SLOTS, "the audit finds what is there"
    assert verb("people", "find", store, "Ada Lovelace") == 1
    assert verb("people", "forget", store, "Ada Lovelace", "--also", copy, export) == 0
    assert f"{SLOTS * 16} rows deleted" in capsys.readouterr().out
    assert left() == []
    for path in (store, copy):
        with sqlite3.connect(path) as connection:
            assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert verb("people", "find", path, "10", "--run", 1) == 0
    assert "Nothing of run 1 track 10" in capsys.readouterr().out


def test_somebody_is_forgotten_while_a_writer_writes(tmp_path: Path) -> None:
    store = tmp_path / "hall.db"
    write(store)
    with StoreWriter(store, run(started_ns=STARTED_NS + 10**12)) as writer:
        written = 0
        while written < 20:
            writer.append(record(written), time_ns=STARTED_NS + 10**12 + written, wait=True)
            written += 1
        (asked,) = requests_of(store, ((1, PERSON),))
        assert forget(store, asked)[1] == SLOTS + 3
        write_anew(store)
        writer.append(record(written), time_ns=STARTED_NS + 10**12 + written, wait=True)
        assert writer.flush(30.0)
    assert kept_of(store, ((2, PERSON),))["poses"] == written + 1
    assert not any(kept_of(store, ((1, PERSON),)).values())


def test_other_files_are_refused(tmp_path: Path) -> None:
    store, other = tmp_path / "hall.db", tmp_path / "walk.c3d"
    write(store)
    other.write_bytes(b"C3D")
    (tmp_path / "odd.csv").write_text("a,b\n1,2\n")
    assert verb("people", "forget", store, "10", "--also", other) == 2
    assert verb("people", "forget", store, "10", "--also", tmp_path / "odd.csv") == 2
    assert kept_of(store, ((1, PERSON),))["poses"] == SLOTS, "nothing was removed"


def test_verbs_name_people_of_a_site(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = tmp_path / "hall.db"
    write(store)
    assert verb("people", "name", store, "10", "Ada") == 0
    assert verb("people", "merge", store, "11", "Bob") == 2, "nobody has that name"
    assert verb("people", "list", store) == 0
    said = capsys.readouterr().out
    assert "Ada" in said and "Person 11" in said and "run 1 track 11" in said
    assert verb("people", "merge", store, "11", "Ada") == 0
    assert verb("people", "list", store) == 0
    said = capsys.readouterr().out
    assert "Merged 1 track into Ada" in said and "run 1 track 10, 11" in said
    assert verb("people", "forget", store, "Ada") == 0
    assert verb("people", "list", store) == 0
    said = capsys.readouterr().out
    assert said.count("63 rows deleted, 0 left") == 2 and "Nobody is stored" in said
