"""The attack of `make attack`, for some seconds: what it does without a network."""

from __future__ import annotations

import pytest

import attack_inputs
import hostile_inputs
import hostile_tables
import hostile_videos

pytestmark = pytest.mark.slow


def test_decoders_raise_nothing_but_input_errors() -> None:
    result = attack_inputs.fuzz(seconds=60.0, decodes=20_000, seed=3)
    assert result.held, result.figures
    assert result.figures.startswith("20")  # thousand and a few, of all kinds


def test_an_attack_that_gets_through_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(message: object) -> None:
        raise OverflowError("cannot convert float infinity to integer")

    monkeypatch.setattr(attack_inputs, "used", broken)
    result = attack_inputs.fuzz(seconds=60.0, decodes=1000, seed=3)
    assert not result.held and "OverflowError: cannot convert" in result.figures


def test_damaged_files_end_in_one_line() -> None:
    result = attack_inputs.hostile_files(seconds=4.0, seed=3, kinds=())
    assert result.held, result.figures


def test_hostile_tables_and_videos_end_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    for known in (hostile_tables.TABLES, hostile_videos.VIDEOS):
        for name in list(known)[1::4]:  # make attack tries them all
            monkeypatch.delitem(known, name)
        for name in list(known)[1::2]:
            monkeypatch.delitem(known, name)
    trials = list(hostile_inputs.try_all(init=False))
    assert len(trials) > 70
    assert not "\n".join(str(trial) for trial in trials if not trial.held)
    assert {trial.code for trial in trials} == {0, 2}


def test_input_that_gets_through_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(path: object) -> str:
        raise OverflowError("cannot convert float infinity to integer")

    monkeypatch.setattr(hostile_videos, "played", broken)
    for name in list(hostile_videos.VIDEOS)[1:]:
        monkeypatch.delitem(hostile_videos.VIDEOS, name)
    result = attack_inputs.hostile_files(seconds=0.0, seed=3, kinds=("videos",))
    assert not result.held and "OverflowError: cannot convert" in result.figures
