"""Names of people who are there now are those of the store at this moment."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest
from sqlalchemy import delete, insert
from tests.manual_clock import ManualClock
from tests.store.named import ADA, NAMELESS, SITE, run_row, write_named

from e3pose.store import schema
from e3pose.store.database import database_url, writing_engine
from e3pose.store.names import KEPT_S, StoredNames
from e3pose.store.people import set_name


@dataclass
class Clock:
    now_s: float = 0.0

    def __call__(self) -> float:
        self.now_s += KEPT_S
        return self.now_s


@pytest.fixture
def place(tmp_path: Path) -> Path:
    return write_named(tmp_path / "poses.db")


def test_a_rename_and_a_removal_are_known_at_once(place: Path) -> None:
    names = StoredNames(place, SITE, Clock())
    assert (names(ADA), names(NAMELESS), names(99), names(-1)) == ("Ada", "", "", "")
    set_name(place, [(1, ADA)], "Ada L.")
    set_name(place, [(1, NAMELESS)], "Bob")
    assert (names(ADA), names(NAMELESS)) == ("Ada L.", "Bob")
    engine = writing_engine(database_url(place))
    with engine.begin() as connection:
        connection.execute(delete(schema.tracks).where(schema.tracks.c.track_id == ADA))
    engine.dispose()
    assert names(ADA) == ""


def test_names_are_of_the_newest_run_of_the_site(place: Path) -> None:
    engine = writing_engine(database_url(place))
    with engine.begin() as connection:
        connection.execute(insert(schema.runs), run_row(2))
    engine.dispose()
    assert StoredNames(place, SITE)(ADA) == "", "track 10 is somebody else now"
    assert StoredNames(place, "elsewhere")(ADA) == ""


def test_a_store_that_is_not_there_names_nobody(tmp_path: Path) -> None:
    assert not StoredNames().look(None) and StoredNames()(ADA) == ""
    names = StoredNames(tmp_path / "none.db", SITE, Clock())
    assert names(ADA) == ""
    write_named(tmp_path / "none.db")
    assert names(ADA) == "Ada", "once it is"


def test_an_answer_serves_for_a_moment(place: Path) -> None:
    clock = ManualClock()
    names = StoredNames(place, SITE, lambda: clock.now_ns() / 1e9)
    assert names(ADA) == "Ada"
    set_name(place, [(1, ADA)], "Eve")
    assert names(ADA) == "Ada", "asked just now"
    clock.advance(KEPT_S)
    assert names(ADA) == "Eve"
