"""Who answers: cameras that never do are given up, and tried again."""

from __future__ import annotations

import numpy as np

from e3pose.liveness import MISSES, RETRY_LIMIT_S, Silence, listen

INTERVAL_S = 0.04
BOTH = np.array([True, True])
FIRST = np.array([True, False])
NONE = np.array([False, False])


def test_a_camera_that_misses_in_a_row_is_given_up_and_tried_again() -> None:
    silence = Silence.none(2)
    for slot in range(MISSES):
        assert silence.answering(slot).all()
        silence = listen(silence, slot, BOTH, FIRST, INTERVAL_S)
    assert silence.answering(MISSES).tolist() == [True, False]
    assert silence.answering(MISSES + round(1 / INTERVAL_S)).all()


def test_it_is_tried_ever_more_rarely_but_never_forgotten() -> None:
    silence, slot, waits = Silence.none(2), 0, []
    for _ in range(MISSES + 6):
        silence = listen(silence, slot, ~FIRST, NONE, INTERVAL_S)
        waits.append(int(silence.retry_slot[1]) - slot)
        slot = max(slot + 1, int(silence.retry_slot[1]))
    assert waits[MISSES:] == sorted(waits[MISSES:])
    assert waits[-1] == RETRY_LIMIT_S / INTERVAL_S


def test_one_answer_is_enough() -> None:
    silence = Silence.none(2)
    for slot in range(20):
        silence = listen(silence, slot, BOTH, FIRST, INTERVAL_S)
    silence = listen(silence, 20, BOTH, BOTH, INTERVAL_S)
    assert silence.answering(21).all()
    assert silence.missed.tolist() == [0, 0]


def test_a_camera_that_was_not_asked_misses_nothing() -> None:
    silence = Silence.none(2)
    for slot in range(100):
        silence = listen(silence, slot, FIRST, FIRST, INTERVAL_S)
    assert silence.missed.tolist() == [0, 0]


def test_lost_messages_seldom_cost_a_camera() -> None:
    rng = np.random.default_rng(0)
    silence, away = Silence.none(2), 0
    for slot in range(5000):
        asked = silence.answering(slot)
        silence = listen(silence, slot, asked, asked & (rng.uniform(size=2) > 0.3), INTERVAL_S)
        away += int((~asked).sum())
    assert away / 10_000 < 0.06
