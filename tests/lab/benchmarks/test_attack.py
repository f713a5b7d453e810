"""The attack of `make attack`, for some seconds: what it does without a network."""

from __future__ import annotations

from dataclasses import replace

import pytest

import attack
import attack_inputs
import hostile_inputs
import hostile_tables
import hostile_videos
from attack import FPS, PAGE, ROOTS, TABLE, TESTED, TESTS, Course, Pace
from attack_inputs import SECOND, Result
from attack_lies import Seen

pytestmark = pytest.mark.slow


def test_decoders_raise_nothing_but_input_errors() -> None:
    result = attack_inputs.fuzz(seconds=60.0, decodes=6_000, seed=3)
    assert result.held, result.figures
    assert result.figures.startswith("6")  # thousand and a few, of all kinds


def test_an_attack_that_gets_through_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(message: object) -> None:
        raise OverflowError("cannot convert float infinity to integer")

    monkeypatch.setattr(attack_inputs, "used", broken)
    result = attack_inputs.fuzz(seconds=60.0, decodes=1000, seed=3)
    assert not result.held and "OverflowError: cannot convert" in result.figures


def test_damaged_files_end_in_one_line() -> None:
    result = attack_inputs.hostile_files(seconds=1.0, seed=3, kinds=())
    assert result.held, result.figures


def test_hostile_tables_and_videos_end_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    for known in (hostile_tables.TABLES, hostile_tables.BOMBS, hostile_videos.VIDEOS):
        for name in {*known} - {*list(known)[::12]}:  # make attack tries them all
            monkeypatch.delitem(known, name)
    trials = list(hostile_inputs.try_all(init=False))
    assert len(trials) > 14
    assert not "\n".join(str(trial) for trial in trials if not trial.held)
    assert {trial.code for trial in trials} == {0, 2}

    def broken(path: object) -> str:
        raise OverflowError("cannot convert float infinity to integer")

    monkeypatch.setattr(hostile_videos, "played", broken)
    result = attack_inputs.hostile_files(seconds=0.0, seed=3, kinds=("videos",))
    assert not result.held and "OverflowError: cannot convert" in result.figures


def test_every_row_says_what_was_tried_what_must_be_and_what_was(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    course = Course({"files": 240.0, "tested": 480.0})
    course.begin("files")
    one = Result("a flood", "12 | 25 poses", True, "22 poses")
    now_s[0] = 120.0
    for result in (one, replace(one, held=False, again=True), replace(one, held=False)):
        course.report(result)
    course.begin("tested")
    course.report(Result(f"{ROOTS}a disk", "SKIPPED: mount", True, "passes", left_out=True))
    for held in (True, False):
        course.report(Result(f"a lie {held}", "25 poses", held, "22 poses", 0.9 + held / 20))
    course.report(Result(f"a knock{SECOND}", "24 poses", True, "22 poses", 0.96))
    said = capsys.readouterr().out
    assert "-- files, about 12 min left" in said and "-- tested, about 8 min left" in said
    line = "held      a flood; must be: 22 poses; was: 12 | 25 poses (about 10 min left)"
    assert line in said
    assert all(f"\n{word}" in said for word in ("AGAIN ", "FAILED ", "left out "))
    rows, sums = course.rows("make attack"), course.sums("make attack")
    assert all("`make attack`" in each and "load" in each for each in (rows, sums))
    assert "| a flood | 22 poses | 12 / 25 poses |" in rows
    assert "| a flood | 22 poses | **did not hold**: 12 / 25 poses |" in rows
    assert f"| {ROOTS}a disk | passes | **left out**: SKIPPED: mount |" in rows
    assert "| `files` | 1 of 2 | 0 |  |" in sums
    assert "| `tested` | 2 of 3 | 1 | 90 |" in sums
    assert TABLE.sub("\0", PAGE.read_text()).count("\0") == 1, "the page has its place"


def test_a_site_is_compared_with_itself_just_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a busy machine takes from both changes nothing; what an attack takes does."""
    now_s, rate, seen = [0.0], [0.0], Seen()

    def wait(seconds: float) -> None:
        for _ in range(round(seconds * rate[0])):
            now_s[0] += 1 / rate[0]
            seen.poses.append((now_s[0] - 1e-6, 0, 0.1, 3, attack.HONEST[:2]))

    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    monkeypatch.setattr(attack, "wait", wait)
    for before, meanwhile, kept in ((FPS, FPS, True), (12.5, 12.5, True), (FPS, 20.0, False)):
        rate[0] = before
        usual, begun_s = Pace.quiet(seen), now_s[0]
        rate[0] = meanwhile
        wait(10.0)
        assert Pace.since(seen, begun_s).keeps(usual) == kept


def test_attacks_that_are_tests_are_there() -> None:
    for place in TESTED.values():
        file, _, name = place.partition("::")
        assert f"def {name.partition('[')[0]}(" in (TESTS / file).read_text() or not name, place
