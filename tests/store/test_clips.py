"""Clips of a store: marked, named, noted, removed; and what is stored of their time deleted."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.cases import each_case
from tests.store.conftest import STARTED_NS, record, run

from e3pose.base.errors import InputError
from e3pose.output.archive.deleting import delete_everywhere
from e3pose.store import Store, StoreWriter
from e3pose.store.clips import Clip, change_clip, clips_of, keep_clip, remove_clip
from e3pose.store.forgetting import Forgotten

Place = Path | str
SLOTS = 60
SITE = "hall"


def at_ns(slot: int) -> int:
    return STARTED_NS + slot * 40_000_000


@pytest.fixture
def stored(place: Place) -> Place:
    with StoreWriter(place, run()) as writer:
        for slot in range(SLOTS):
            writer.append(record(slot), time_ns=at_ns(slot), wait=True)
        assert writer.flush(30.0)
    return place


def test_clips_are_kept_changed_and_removed(stored: Place) -> None:
    assert clips_of(stored, SITE) == []
    walk = keep_clip(stored, SITE, Clip("walk", at_ns(10), at_ns(20), "slow\nthen fast", made_ns=7))
    gone = keep_clip(stored, SITE, Clip("before", 1, 2))
    assert walk.number != gone.number
    assert clips_of(stored, SITE) == [(walk, True), (gone, False)]
    assert clips_of(stored, "elsewhere") == []
    changed = change_clip(stored, SITE, walk.number, {"name": "run"})
    assert (changed.name, changed.note, changed.start_ns) == ("run", "slow\nthen fast", at_ns(10))
    assert remove_clip(stored, SITE, walk.number) == changed
    assert [clip for clip, _ in clips_of(stored, SITE)] == [gone]
    assert len(Store(stored).rows("slots")) == SLOTS, "what is stored stays"
    with pytest.raises(InputError, match="expected one of the site"):
        change_clip(stored, SITE, walk.number, {"name": "x"})
    with pytest.raises(InputError, match="expected one of the site"):
        remove_clip(stored, "elsewhere", gone.number)


@each_case(
    ("name", "start_ns", "end_ns", "note", "words"),
    [
        ("", 1, 2, "", "characters, one line"),
        ("a\nb", 1, 2, "", "characters, one line"),
        ("x" * 101, 1, 2, "", "characters, one line"),
        ("a", 2, 2, "", "the earlier time first"),
        ("a", -1, 2, "", "the earlier time first"),
        ("a", 1, 2**63, "", "the earlier time first"),
        ("a", 0, 9 * 86_400 * 10**9, "", "a clip of 9 days.*eight days at most"),
        ("a", 1, 2, "x" * 1001, "at most 1000"),
        ("a", 1, 2, "\0", "no NUL"),
    ],
)
def test_what_is_no_clip_is_refused(
    name: str, start_ns: int, end_ns: int, note: str, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        Clip(name, start_ns, end_ns, note)


def test_what_is_stored_of_a_clip_can_be_deleted(stored: Place) -> None:
    (deleted,) = delete_everywhere(stored, Forgotten(SITE, at_ns(10), at_ns(20) + 1))
    assert deleted.left == 0 and deleted.rows == 11 + 22
    slots = [row["slot"] for row in Store(stored).rows("slots")]
    assert slots == [*range(10), *range(21, SLOTS)]
    assert len(Store(stored).query()) == 2 * len(slots)


def test_a_part_of_a_day_is_not_deleted_where_archives_have_the_day(tmp_path: Path) -> None:
    from tests.cli.commands import run as verb

    store = tmp_path / "hall.db"
    with StoreWriter(store, run()) as writer:
        for slot in range(SLOTS):
            writer.append(record(slot), time_ns=at_ns(slot), wait=True)
    part = Forgotten(SITE, at_ns(10), at_ns(20) + 1)
    delete_everywhere(store, part)
    # An archive that is made later never had what was deleted, and keeps the rest of the day.
    (tmp_path / "archive").mkdir()
    assert verb("archive", store, tmp_path / "archive", "--new") in (0, 1)
    files = sorted((tmp_path / "archive").rglob("*.parquet"))
    assert files
    with pytest.raises(InputError, match=r"expected a whole day"):
        delete_everywhere(store, Forgotten(SITE, at_ns(30), at_ns(40)))
    assert len(Store(store).rows("slots")) == SLOTS - 11
    assert sorted((tmp_path / "archive").rglob("*.parquet")) == files
