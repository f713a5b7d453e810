"""The check of rests: when everybody is awake, what is compared, when no camera rests any more."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.energy.modes import Rest
from e3pose.energy.rest_costs import rest_costs
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.waking import asleep_in
from e3pose.recording import Recording
from e3pose.select import rest_plan
from e3pose.select.rest_plan import (
    LEAST_ROUNDS,
    STRETCH_S,
    STRETCHES,
    RestCheck,
    RestMemory,
    rested,
)
from e3pose.simulate import SceneSettings, simulate

SLOT_S = 0.08
ROUND = round(STRETCH_S * STRETCHES / SLOT_S)


def after_rounds(check: RestCheck, count: int, ratio: float, seed: int = 0) -> RestCheck:
    """Rounds in which errors are `ratio` times as large while cameras rest, give or take 5 %."""
    rng = np.random.default_rng(seed)
    first = check.round * ROUND
    for slot in range(first, first + count * ROUND + 1):
        asleep = not check.wakes(slot, SLOT_S)
        error_m = 0.03 * (ratio if asleep else 1.0) * np.exp(rng.normal(0, 0.05))
        check = check.after(slot, SLOT_S, asleep, error_m)
    return check


def test_everybody_is_awake_for_a_sixteenth_of_the_time_and_rests_end_before() -> None:
    check = RestCheck()
    awake = [check.wakes(slot, SLOT_S) for slot in range(ROUND)]
    assert np.mean(awake) == pytest.approx(1 / STRETCHES)
    for slot in range(ROUND):
        left = round(check.left_s(slot, SLOT_S) / SLOT_S)
        assert awake[slot + left] and not any(awake[slot : slot + left])


def test_nobody_rests_where_rests_cost_more_than_a_tenth_until_they_do_not() -> None:
    assert not after_rounds(RestCheck(), LEAST_ROUNDS - 1, 1.5).idle  # too early to say
    dear = after_rounds(RestCheck(), 6, 1.3)
    assert dear.idle
    assert np.expm1(dear.mean) == pytest.approx(0.3, abs=0.02)
    assert "no camera rests" in dear.operator_note() and "+30% ± 2%" in dear.operator_note()
    first = dear.round * ROUND
    awake = [dear.wakes(slot, SLOT_S) for slot in range(first, first + ROUND)]
    assert np.mean(awake) == pytest.approx(1 - 1 / STRETCHES)  # and is tried again
    again = after_rounds(dear, 40, 1.0)
    assert not again.idle and "no camera rests" not in again.operator_note()


@each_case("ratio", [0.9, 1.0, 1.05])
def test_rests_that_cost_less_stay(ratio: float) -> None:
    for seed in range(3):
        assert not after_rounds(RestCheck(), 40, ratio, seed).idle


def test_who_sleeps_when_nobody_should_and_who_is_not_there_say_nothing() -> None:
    late = unknown = RestCheck()
    for slot in range(8 * ROUND):
        late = late.after(slot, SLOT_S, True, 0.03)
        unknown = unknown.after(slot, SLOT_S, not unknown.wakes(slot, SLOT_S), np.nan)
    assert late.rounds == unknown.rounds == 0 and late.operator_note() == ""


def test_no_rest_outlasts_the_time_until_everybody_is_awake() -> None:
    costs = rest_costs([12.5] * 3, [6.25] * 3, [Rest("suspended", 0.5, 0.5, 1.0, 0.2)] * 3)
    everybody = np.ones(3, dtype=bool)
    leave, rest_s = rested(costs, RestMemory.none(3), everybody, 1, 5.0)
    assert leave.all() and rest_s.max() == 5.0
    assert not rested(costs, RestMemory.none(3), everybody, 1, 1.0)[0].any()


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(SceneSettings(scene="one-sided", seconds=40.0, fps=1 / SLOT_S), 702)


@pytest.mark.slow
def test_a_replay_wakes_everybody_in_the_last_stretch_of_a_round(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("STRETCH_S", 5.0), ("STRETCHES", 3), ("SETTLE_S", 0.5)):
        monkeypatch.setattr(rest_plan, name, value)
    rest = Rest("suspended", 0.5, 0.5, 1.0, 0.2)
    costs = rest_costs([12.5] * 6, [6.25] * 6, [rest] * 6)
    settings = ReplaySettings(
        num_selected=2.0, rest="suspended", rest_costs=costs, lead_slots=2, find_within_s=2.0
    )
    asleep = np.asarray(asleep_in(list(replay(recording, settings)), 2).any(axis=1))
    stretch = (np.arange(len(asleep)) * SLOT_S // 5.0).astype(int) % 3
    assert asleep[stretch < 2].mean() > 0.5
    assert not asleep[stretch == 2].any()
