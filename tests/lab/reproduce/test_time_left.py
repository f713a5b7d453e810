"""The time left of a reproduction falls as work is done, whatever the pieces cost."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from tests.manual_clock import ManualClock

from e3pose_lab.reproduce import time_left
from e3pose_lab.reproduce.sources import Sources
from e3pose_lab.reproduce.time_left import TimeLeft, duration_text
from e3pose_lab.reproduce.work import AnyPiece, Piece


def quick(sources: Sources, asked: int) -> int:
    return asked


def slow(sources: Sources, asked: int) -> int:
    return asked


@pytest.fixture(autouse=True)
def known(monkeypatch: pytest.MonkeyPatch) -> None:
    costs = {"test_time_left-quick": 0.5, "test_time_left-slow": 20.0}
    monkeypatch.setattr(time_left, "EXPECTED_S", costs)


def shared(count: int) -> list[AnyPiece]:
    return [Piece(quick, number) for number in range(count)]


def timed(count: int) -> list[AnyPiece]:
    return [Piece(slow, number, times=True) for number in range(count)]


def said(
    pieces: list[AnyPiece], jobs: int, took_s: Callable[[AnyPiece], float]
) -> tuple[list[float], list[float]]:
    """Return what is said to be left, every second, and what is left."""
    clock = ManualClock()
    left = TimeLeft(pieces, jobs, lambda: clock.time_ns / 1e9)
    rest_s = sum(map(took_s, pieces))
    told, true = [left.left_s()], [rest_s]
    for piece in pieces:
        seconds = took_s(piece)
        while seconds > 0:
            step = min(seconds, 1.0)
            clock.advance(step)
            seconds, rest_s = seconds - step, rest_s - step
            told.append(left.left_s())
            true.append(rest_s)
        left.done(piece)
        told.append(left.left_s())
        true.append(rest_s)
    return told, true


@pytest.mark.parametrize("slower", [0.5, 1.0, 3.0])
def test_time_left_is_near_and_hardly_rises(slower: float) -> None:
    drawn = random.Random(0)
    pieces = [*shared(2000), *timed(10)]
    took_s = {
        id(piece): drawn.uniform(0.2, 1.8) * (20.0 if piece.times else slower * 0.5 / 2)
        for piece in pieces
    }
    told, true = said(pieces, 2, lambda piece: took_s[id(piece)])
    settled = next(n for n, rest in enumerate(true) if rest < 0.9 * true[0])
    for now, rest in zip(told[settled:], true[settled:], strict=True):
        assert rest / 1.5 - 20 <= now <= 1.5 * rest + 20
    for before, after in zip(told[settled:], told[settled + 1 :], strict=False):
        assert after < 1.4 * before + 5


def test_time_left_never_vanishes_during_a_long_piece() -> None:
    told, _ = said(timed(2), 1, lambda piece: 120.0)
    assert all(seconds > 0 for seconds in told[:-1]) and told[-1] == 0
    assert told[:100] == sorted(told[:100], reverse=True)


def test_words_are_coarse() -> None:
    assert [duration_text(s) for s in (0.2, 34.0, 355.0, 4885.0, 9000.0)] == [
        "about 10 s left", "about 40 s left", "about 6 min left", "about 81 min left",
        "about 2.5 h left",
    ]  # fmt: skip
