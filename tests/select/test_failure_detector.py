"""Who answers: cameras that never do are given up, and tried again; late answers are answers."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case

from e3pose.select.failure_detector import (
    MEAN_LIFE_S,
    MEMORY_ORDERS,
    RETRY_LIMIT_S,
    USELESS_S,
    Silence,
    acknowledge_late,
    listen,
    patience,
)

INTERVAL_S = 0.04
BOTH = np.array([True, True])
FIRST = np.array([True, False])
NONE = np.array([False, False])
MISSES = 5  # with the 5 % that any link may lose


def losing(loss: float, lead: int, slots: int, dead_from: int) -> tuple[float, float]:
    """Run five cameras behind a link that loses; the first dies."""
    rng, silence, left_out = np.random.default_rng(0), Silence.none(5), 0
    orders: list[NDArray[np.bool_]] = [np.ones(5, dtype=bool)] * lead
    noticed_s = np.inf
    for slot in range(slots):
        ordered = orders.pop(0)
        arrived = ordered & (rng.random(5) >= loss)
        arrived[0] &= slot < dead_from
        silence = listen(silence, slot, ordered, arrived, INTERVAL_S)
        orders.append(silence.answering(slot + lead))
        left_out += int((~orders[-1][1:]).sum())
        if slot >= dead_from and not orders[-1][0]:
            noticed_s = min(noticed_s, (slot + 1 - dead_from) * INTERVAL_S)
    return left_out / (4 * slots), noticed_s


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


def test_orders_on_their_way_are_no_further_attempts() -> None:
    silence = Silence.none(2)
    for slot in range(MISSES + 10):
        silence = listen(silence, slot, BOTH, FIRST, INTERVAL_S)
    assert silence.failures.tolist() == [0, 1]
    assert silence.retry_slot[1] == MISSES - 1 + round(1 / INTERVAL_S)


def test_a_camera_that_was_not_asked_misses_nothing() -> None:
    silence = Silence.none(2)
    for slot in range(100):
        silence = listen(silence, slot, FIRST, FIRST, INTERVAL_S)
    assert silence.missed.tolist() == [0, 0]


@each_case("loss", [0.05, 0.1, 0.3, 0.5])
def test_death_is_presumed_once_it_is_likelier_than_bad_luck(loss: float) -> None:
    misses = int(patience(np.array([loss]), INTERVAL_S)[0])

    def odds(k: int) -> float:
        return k * INTERVAL_S / MEAN_LIFE_S / loss**k

    assert odds(misses) >= 1 > odds(misses - 1)


def test_no_link_is_thought_better_or_worse_than_links_are() -> None:
    ends = patience(np.array([0.0, 0.05, 0.5, 1.0]), INTERVAL_S)
    assert ends[0] == ends[1] < ends[2] == ends[3]


@each_case("lead", [1, 4])
@each_case("loss", [0.0, 0.05, 0.3])
def test_losses_cost_no_camera_and_deaths_show_within_two_seconds(loss: float, lead: int) -> None:
    left_out, noticed_s = losing(loss, lead, 4000, 3000)
    assert left_out < 0.002
    assert noticed_s < 2.0


def test_losses_are_learned() -> None:
    rng, silence = np.random.default_rng(0), Silence.none(2)
    shares = np.array([0.3, 0.0])
    for slot in range(10 * MEMORY_ORDERS):
        silence = listen(silence, slot, BOTH, rng.random(2) >= shares, INTERVAL_S)
    np.testing.assert_allclose(silence.loss, shares, atol=0.1)  # three standard deviations


def test_late_views_are_signs_of_life() -> None:
    silence = Silence.none(2)
    for slot in range(30):
        silence = acknowledge_late(silence, ~FIRST & bool(slot % 4), NONE, INTERVAL_S)
        silence = listen(silence, slot, BOTH, FIRST, INTERVAL_S)
        assert silence.answering(slot + 1).all()


def test_a_camera_whose_views_are_all_late_is_given_up_within_two_seconds() -> None:
    silence, slot = Silence.none(2), 0
    while silence.answering(slot).all():
        silence = acknowledge_late(silence, ~FIRST, NONE, INTERVAL_S)
        silence = listen(silence, slot, BOTH, FIRST, INTERVAL_S)
        slot += 1
    assert slot * INTERVAL_S == pytest.approx(USELESS_S, abs=INTERVAL_S) and USELESS_S < 2
    silence = acknowledge_late(
        silence, ~FIRST, NONE, INTERVAL_S
    )  # what is late gives it no new chance
    assert not silence.answering(slot)[1]
    retry = int(silence.retry_slot[1])
    silence = listen(silence, retry, BOTH, BOTH, INTERVAL_S)  # a view in time does
    assert silence.answering(retry + 1).all()


def test_a_camera_whose_orders_are_late_is_not_to_blame() -> None:
    silence = Silence.none(2)
    for slot in range(200):
        silence = acknowledge_late(silence, NONE, ~FIRST & (slot % 4 == 0), INTERVAL_S)
        silence = listen(silence, slot, BOTH, FIRST, INTERVAL_S)
        assert silence.answering(slot + 1).all()
