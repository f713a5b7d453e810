"""What is deleted at a site is deleted at the hubs that have it, by the cursor of summaries."""

from __future__ import annotations

from pathlib import Path

import pytest
from sqlalchemy import Engine
from tests.cli.commands import run as run_verb
from tests.hub.site import MINUTE, fill
from tests.hub.test_hub import answers, hub_file
from tests.postgres import Server

from e3pose.base.errors import InputError
from e3pose.site.outbox_answers import OutboxAnswers
from e3pose.store.forgetting import DAY_NS, Forgotten, day_of, forget, of_day
from e3pose.store.outbox import read_outbox
from e3pose.store.summaries import MINUTE_NS
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import OutboxPart, Tombstone
from e3pose_hub.database import cursor_of, open_hub, read_forgotten, read_rows
from e3pose_hub.pull import pull

pytestmark = pytest.mark.slow

FIRST = (DAY_NS - MINUTE % DAY_NS) // MINUTE_NS  # minutes of the first day
DAY = day_of(MINUTE)


def fetch(engine: Engine, store: Path) -> int:
    box = answers(store)
    return pull(engine, "lab", lambda q: box.answer("e3pose/lab/outbox/house", q), lambda: None, 1)


def counts(database: str) -> tuple[int, int]:
    """Return how many summaries and hours a hub has."""
    return len(read_rows(database, "summaries")[1]), len(read_rows(database, "hours")[1])


def test_deleted_day_and_person_reach_a_hub_of_either_kind(
    tmp_path: Path, postgres: Server, capsys: pytest.CaptureFixture[str]
) -> None:
    store = tmp_path / "lab.db"
    fill(store, "lab", FIRST - 150, 300)  # half of it before midnight
    hub_file(tmp_path, {"lab": 7447})
    places = (str(tmp_path / "hub.db"), postgres.new_hub())
    engines = [open_hub(place) for place in places]
    assert [fetch(engine, store) for engine in engines] == [300, 300]
    _, before_hours = counts(places[0])
    what, rows = forget(store, of_day("lab", DAY))
    assert rows == 150 and what.outbox_number == 301
    person, _ = forget(store, Forgotten("lab", MINUTE, MINUTE, MINUTE, 7))
    assert person.outbox_number == 302 and forget(store, what)[0].outbox_number == 301
    fill(store, "lab", FIRST + 150, 10)  # numbers go on after them
    assert read_outbox(store, "lab").newest == 312
    for engine, place in zip(engines, places, strict=True):
        assert fetch(engine, store) == 10
        assert counts(place)[0] == 160 and counts(place)[1] < before_hours
        with engine.connect() as connection:
            cursor = cursor_of(connection, "lab")
        assert (cursor.taken, cursor.lost) == (312, 0)
        day, other = sorted(read_forgotten(place), key=lambda one: one.deleted, reverse=True)
        assert (day.deleted, day.left, day.track_id) == (150, 0, None)
        assert (other.deleted, other.left, other.track_id) == (0, 0, 7)
        assert fetch(engine, store) == 0 and len(read_forgotten(place)) == 2
    assert run_verb("hub", "forgotten", tmp_path) == 0
    shown = capsys.readouterr().out
    assert f"day {DAY}" in shown and "person 7 of the run that began" in shown


def test_site_shows_which_hubs_have_heard_of_a_deletion(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store, boxes = tmp_path / "lab.db", dict[str, OutboxAnswers]()
    fill(store, "lab", FIRST - 150, 300)
    engines = {hub: open_hub(str(tmp_path / f"{hub}.db")) for hub in ("house", "city")}

    def fetched(hub: str) -> None:
        box = boxes.setdefault(hub, answers(store))  # as one edge that runs on
        topic = f"e3pose/lab/outbox/{hub}"
        pull(engines[hub], "lab", lambda q: box.answer(topic, q), lambda: None, 1)

    def told(code: int) -> str:
        assert run_verb("archive", "deleted", store) == code
        return capsys.readouterr().out

    forget(store, of_day("lab", DAY))
    assert told(0) == f"day {DAY}: no hub has asked this site\n"
    for hub in engines:
        fetched(hub)
        fetched(hub)
    assert told(0) == f"day {DAY}: city heard, house heard\n"
    forget(store, Forgotten("lab", MINUTE, MINUTE, MINUTE, 7))
    assert "person 7 of the run that began" in told(1)
    fetched("house")
    fetched("house")  # a minute later it confirms what it was told
    assert told(1).splitlines()[1].endswith(": house heard, city not yet")
    boxes.clear()  # the edge is started again
    fetched("city")
    fetched("city")
    assert told(0).splitlines()[1].endswith(": city heard, house heard")


def test_hub_that_comes_later_hears_of_it_too_and_misses_nothing(tmp_path: Path) -> None:
    store = tmp_path / "lab.db"
    fill(store, "lab", FIRST - 5, 10)
    forget(store, of_day("lab", DAY))
    engine = open_hub(str(tmp_path / "hub.db"))
    assert fetch(engine, store) == 5
    with engine.connect() as connection:
        cursor = cursor_of(connection, "lab")
    assert (cursor.taken, cursor.lost) == (11, 5)
    assert len(read_forgotten(str(tmp_path / "hub.db"))) == 1


def test_many_deletions_come_in_parts_and_each_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("e3pose.store.outbox.MOST_FORGOTTEN", 10)
    store = tmp_path / "lab.db"
    fill(store, "lab", FIRST, 3)
    for track in range(25):
        forget(store, Forgotten("lab", MINUTE, MINUTE, MINUTE, track))
    fill(store, "lab", FIRST + 3, 3)
    engine = open_hub(str(tmp_path / "hub.db"))
    assert fetch(engine, store) == 6
    found = read_forgotten(str(tmp_path / "hub.db"))
    assert sorted(one.track_id or 0 for one in found) == [*range(25)]
    with engine.connect() as connection:
        assert cursor_of(connection, "lab").lost == 0


def test_a_store_from_before_brings_no_deleted_day_back(tmp_path: Path) -> None:
    fill(tmp_path / "lab.db", "lab", FIRST - 5, 10)
    fill(tmp_path / "copy.db", "lab", FIRST - 5, 11)
    engine = open_hub(str(tmp_path / "hub.db"))
    fetch(engine, tmp_path / "lab.db")
    forget(tmp_path / "lab.db", of_day("lab", DAY))
    fetch(engine, tmp_path / "lab.db")
    with engine.begin() as connection:  # the copy is another outbox
        connection.exec_driver_sql("UPDATE sites SET begun_ns = 1")
    fetch(engine, tmp_path / "copy.db")
    (found,) = read_forgotten(str(tmp_path / "hub.db"))
    assert found.left == 0 and counts(str(tmp_path / "hub.db"))[0] == 6


@pytest.mark.parametrize(
    "told",
    [
        (Tombstone(0, 1, 2),),
        (Tombstone(9, 1, 2),),
        (Tombstone(3, 1, 2), Tombstone(3, 1, 2)),
        (Tombstone(1, 2, 1),),
        tuple(Tombstone(number, 1, 2) for number in range(1, 1500)),
    ],
)
def test_deletions_that_no_edge_sends_are_refused(
    tmp_path: Path, told: tuple[Tombstone, ...]
) -> None:
    engine = open_hub(str(tmp_path / "hub.db"))
    newest = 5 if len(told) < 10 else 2000
    part = encode(OutboxPart(1, newest, 0, b"[]", "", told))
    with pytest.raises(InputError, match="lab: deleted"):
        pull(engine, "lab", lambda _: part, lambda: None, 1)
    assert read_forgotten(str(tmp_path / "hub.db")) == []
