"""Who is awake, and the check of rests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from tests.cases import each_case
from tests.rigs import looking
from tests.select import outlooks
from tests.select.outlooks import known
from tests.select.test_expected_information import outlook, person

from e3pose.base.arrays import Flags, Floats
from e3pose.energy.modes import Rest
from e3pose.energy.rest_costs import RestCosts, rest_costs
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.waking import asleep_in
from e3pose.model.look_request import LookRequest
from e3pose.recording import Recording
from e3pose.select import rest_plan
from e3pose.select.awake import RestPlanner, needs_of
from e3pose.select.expected_information import Foresight, foresee
from e3pose.select.policies.base import Situation
from e3pose.select.rest_plan import (
    EMPTY_REST_S,
    FEWEST_AWAKE,
    FEWEST_WITH_PEOPLE,
    FIRST_REST_S,
    LEAST_ROUNDS,
    LENT,
    LONGEST_REST_S,
    REPAY_S,
    STRETCH_S,
    STRETCHES,
    Needs,
    RestCheck,
    RestGoal,
    RestMemory,
    next_rest_s,
    planned,
    rested,
    risen,
    shrinking,
)
from e3pose.select.stated_error import StatedError
from e3pose.simulate import SceneSettings, simulate

N = 5
RIG = looking((4, 0), (3, 2.5), (0, 4), (-4, 0), (0, -4))
ALL = np.ones(N, dtype=bool)
SUSPENDED = Rest("suspended", 0.5, 0.5, 1.0, 0.2)


def costs(rests: Sequence[Rest | None] = (SUSPENDED,) * N) -> RestCosts:
    return rest_costs([12.5] * N, [6.25] * N, rests)


def none(sets: Flags) -> Floats:
    return np.zeros(len(sets))


def needs(
    gains: Sequence[float],
    people: int = 1,
    newcomers: bool = False,
    kept: int = 0,
    watching: int = 0,
) -> Needs:
    """Cameras add up, so that each is worth what it says; errors double without those `kept`.

    Nobody is followed or found anywhere without those `watching`.
    """

    def worth(sets: Flags) -> Floats:
        return np.asarray(sets @ np.array(gains))

    def error_m(sets: Flags) -> Floats:
        return np.asarray(0.1 / np.maximum(sets.sum(axis=1), 1) ** 0.5)

    def rise(sets: Flags) -> Floats:
        return np.where(sets[:, :kept].all(axis=1), 1.0, 2.0)

    def blind(sets: Flags) -> Floats:
        return np.where(sets[:, :watching].all(axis=1), 0.0, 1.0)

    return Needs(people, worth, error_m, rise, blind if people else none, blind, newcomers)


GAINS = (1.0, 0.1, 0.8, 0.2, 0.01)
NONE = RestMemory.none(N)
PRICED = RestGoal(price=0.1, num_selected=2.0)


def awake(goal: RestGoal, wanted: Needs, usable: Flags = ALL, of: RestCosts | None = None) -> Flags:
    return planned(of or costs(), goal, NONE, wanted, usable, 0.08).awake


def test_sets_lose_the_camera_that_is_missed_least() -> None:
    sets, worth = shrinking(ALL, ~ALL, needs(GAINS).worth, 2)
    lost = [int(np.flatnonzero(a & ~b)[0]) for a, b in pairwise(sets)]
    assert lost == [4, 1, 3]
    assert (np.diff(worth) <= 0).all()


def test_two_cameras_that_start_a_person_together_are_kept_together() -> None:
    def worth(sets: Flags) -> Floats:
        return (sets[:, 1] & sets[:, 3]).astype(np.float64)

    sets, values = shrinking(ALL, ~ALL, worth, 2)
    assert np.flatnonzero(sets[-1]).tolist() == [1, 3] and values[-1] == 1


def test_cameras_that_are_worth_their_watts_stay_awake() -> None:
    assert np.flatnonzero(awake(PRICED, needs(GAINS))).tolist() == [0, 2, 3]
    assert np.flatnonzero(awake(PRICED, needs(GAINS, people=0))).tolist() == [0, 2]
    assert awake(replace(PRICED, price=0.0), needs(GAINS)).all()


@each_case("usable", [ALL, np.arange(N) < 3, np.arange(N) < 1])
def test_who_sleeps_or_is_gone_is_not_in_a_plan(usable: Flags) -> None:
    found = awake(PRICED, needs(GAINS), usable)
    assert not (found & ~usable).any()
    assert found.sum() >= min(FEWEST_AWAKE, usable.sum())


def test_a_camera_without_a_rest_is_always_in_a_plan() -> None:
    found = awake(PRICED, needs(GAINS), of=costs([SUSPENDED] * 4 + [None]))
    assert found[4]


@each_case("watts", [25.0, 40.0, 62.5, 100.0])
def test_a_plan_keeps_the_watts(watts: float) -> None:
    goal = RestGoal(price=0.0, watts=watts)
    plan = planned(costs(), goal, NONE, needs(GAINS), ALL, 0.08)
    assert plan.watts <= watts + 1e-9
    assert 0 < plan.num_selected <= plan.awake.sum()


def test_too_few_watts_mean_the_least_that_there_is() -> None:
    goal = RestGoal(price=0.0, watts=1.0)
    plan = planned(costs(), goal, NONE, needs(GAINS), ALL, 0.08)
    assert plan.awake.sum() == FEWEST_AWAKE and plan.num_selected < 0.5


def test_what_is_owed_is_paid_back() -> None:
    goal = RestGoal(price=0.0, watts=30.0)
    rich, poor = (
        planned(costs(), goal, replace(NONE, owed_j=owed), needs(GAINS), ALL, 0.08)
        for owed in (-20.0, 20.0)
    )
    assert poor.watts <= 30 - 20 / 5 + 1e-9 < rich.watts


def test_a_target_is_met_by_the_cheapest_set_that_meets_it() -> None:
    goal = RestGoal(price=0.01, target_m=0.055, num_selected=2.0)
    assert awake(goal, needs((0.0,) * N)).sum() == 4  # 0.1 / sqrt(4) is the first below
    assert awake(replace(goal, target_m=1.0), needs((0.0,) * N)).sum() == FEWEST_WITH_PEOPLE
    assert awake(replace(goal, target_m=0.01), needs((0.0,) * N)).all()  # none meets it


def test_nobody_there_means_as_few_looks_as_find_a_newcomer_in_time() -> None:
    def looks(people: int, newcomers: bool, find_s: float) -> float:
        goal = replace(PRICED, find_within_s=find_s)
        found = planned(costs(), goal, NONE, needs(GAINS, people, newcomers), ALL, 0.08)
        return found.num_selected / (1 if people or newcomers else found.awake.sum())

    assert looks(0, False, 1.0) == pytest.approx(2 * 0.08)
    assert looks(0, False, 4.0) < looks(0, False, 1.0)
    assert looks(0, True, 1.0) == looks(1, False, 1.0) == 2.0  # the first sign of somebody


def test_a_rest_after_which_nobody_needed_the_camera_is_followed_by_the_longest() -> None:
    leave = np.array([False, True, False, True, True])
    takes, rest_s = rested(costs(), NONE, leave, 1)
    assert (takes == leave).all() and (rest_s == FIRST_REST_S).all()
    after = replace(NONE, rest_s=np.where(leave, rest_s, 0.0))
    for people, longest_s in ((1, LONGEST_REST_S), (0, EMPTY_REST_S)):
        expected_s = np.where(leave, longest_s, FIRST_REST_S)
        assert (next_rest_s(after, people) == expected_s).all()


def test_who_would_wake_before_it_has_slept_stays_awake() -> None:
    slow = Rest("suspended", 0.5, 5.0, 10.0, 1.0)
    takes, _ = rested(costs([slow] * N), NONE, ALL, 1)
    assert not takes.any()


def test_nobody_rests_whose_rest_raises_the_error_or_loses_people_who_move() -> None:
    dear = RestGoal(price=10.0, num_selected=2.0)
    assert awake(dear, needs(GAINS)).sum() == 3
    for four in (needs(GAINS, kept=4), needs(GAINS, watching=4)):
        assert awake(dear, four).tolist() == [True, True, True, True, False]
    assert awake(dear, needs(GAINS, kept=5)).all()
    watts = RestGoal(price=0.0, watts=30.0)  # these go before errors
    assert (awake(watts, needs(GAINS, kept=5)) == awake(watts, needs(GAINS))).all()


@each_case("find_s, kept", [(1.0, 4), (4.0, 4), (8.0, 2), (60.0, 2)])
def test_with_nobody_there_those_who_find_newcomers_in_time_stay_awake(
    find_s: float, kept: int
) -> None:
    dear = RestGoal(price=10.0, num_selected=2.0, find_within_s=find_s)
    assert awake(dear, needs(GAINS, people=0, watching=4)).sum() == kept


def test_errors_rise_by_what_cameras_repeat() -> None:
    repeated_m = np.array([[0.04, 0.03], [0.03, 0.03]])
    everybody_m = np.full((2, 1), 0.03)
    found = risen(repeated_m, everybody_m, stated_m=0.05)
    np.testing.assert_allclose(found, [[np.sqrt(1 + 0.0007 / 0.0025), 1], [1, 1]])
    # What is stated cannot be less than what all cameras repeat.
    assert risen(repeated_m, everybody_m, 0.0)[0, 0] == pytest.approx(4 / 3)


def situation(foresight: Foresight, stated: StatedError) -> Situation:
    unseen = np.zeros(N, dtype=np.int64)
    return outlooks.situation(
        N, slot=100, unseen_slots=unseen, foresight=foresight, stated=stated, spread=1.0
    )


def rises(bias_share: float, stated: StatedError, last_seen_s: float = np.inf) -> Floats:
    """Of all five cameras in a ring, of the three on one side, and of the first."""
    seen = outlook(np.stack([person(0, 0), person(1, -1)]), RIG)
    often = np.full(seen.expected.last_seen_s.shape, last_seen_s)
    people = foresee(RIG, replace(known(seen, last_seen_s=often), bias_share=bias_share), 0.04)
    found = needs_of(RIG, situation(people, stated), [people], ~ALL)
    sets = np.array([[1, 1, 1, 1, 1], [1, 1, 1, 0, 0], [1, 0, 0, 0, 0]], dtype=bool)
    return found.rise(sets)


KNOWN = StatedError(0.03, 1.0)


def test_the_fewer_cameras_the_larger_the_error_and_the_more_so_where_errors_last() -> None:
    kind, hard = rises(0.3, KNOWN), rises(1.2, KNOWN)
    for found in (kind, hard):
        assert found[0] == pytest.approx(1.0)
        assert 1.0 < found[1] < found[2]
    assert hard[1] > kind[1] > 1.02


def test_looks_of_the_same_camera_count_once_however_old_the_last_is() -> None:
    np.testing.assert_allclose(rises(0.5, KNOWN, 0.04), rises(0.5, KNOWN, 9.0))


def test_nobody_rests_before_it_is_learned_how_long_errors_last() -> None:
    assert np.isinf(rises(0.3, StatedError(0.03, 0.1))).all()


def test_who_woke_rests_again_only_after_a_look() -> None:
    seen = outlook(np.stack([person(0, 0)]), RIG)
    nobody = foresee(RIG, known(seen, confirmed=np.zeros(1, dtype=bool)), 0.04)
    now = situation(nobody, KNOWN)
    planner = RestPlanner(RIG, costs(), RestGoal(price=10.0, num_selected=2.0, find_within_s=2.0))
    woke = np.full(N, now.slot - 10)
    for unseen, rests in ((300, False), (10, False), (9, True)):
        waiting = replace(now, unseen_slots=np.full(N, unseen))
        _, until = planner.planned(NONE, waiting, woke, lambda seconds: nobody)
        assert bool((until > now.slot).any()) is rests


def test_looks_that_are_asked_for_are_lent_for_seconds_and_paid_back() -> None:
    goal = RestGoal(watts=26.0)
    request = LookRequest(cameras=2.0)
    before = planned(costs(), goal, NONE, needs(GAINS), ALL, 0.08)
    asked = planned(costs(), goal, NONE, needs(GAINS), ALL, 0.08, request)
    assert asked.num_selected > before.num_selected
    assert before.watts <= 26.0 < asked.watts <= 26.0 * (1 + LENT) + 1e-9
    owes = replace(NONE, owed_j=26.0 * REPAY_S)
    assert planned(costs(), goal, owes, needs(GAINS), ALL, 0.08, request).watts < 26.0


def test_enough_looks_are_not_exceeded() -> None:
    goal = RestGoal(num_selected=2.0)
    plan = planned(costs(), goal, NONE, needs(GAINS), ALL, 0.08, LookRequest(enough_per_s=4.0))
    assert plan.num_selected == pytest.approx(0.32)


def test_who_is_awake_while_nobody_is_there_has_watts_left_to_look() -> None:
    goal = RestGoal(watts=N * 6.25 + 0.5)  # all awake, and hardly a look
    nobody = needs(GAINS, people=0)
    plan = planned(costs(), goal, NONE, nobody, ALL, 0.08)
    assert plan.num_selected >= plan.awake.sum() * 2 * 0.08 - 1e-9


def test_operators_are_told_where_nobody_can_rest() -> None:
    planner, memory = RestPlanner(RIG, costs(), PRICED), NONE
    for slot in range(60):
        assert memory.operator_note() == ""
        memory = planner.checked(memory, slot, 1.0, ~ALL, 0.03)
    assert "no camera rests" in memory.operator_note()
    assert planner.checked(memory, 61, 1.0, np.arange(N) == 2, 0.03).operator_note() == ""


SLOT_S = 0.08
ROUND = round(STRETCH_S * STRETCHES / SLOT_S)


def after_rounds(check: RestCheck, count: int, ratio: float) -> RestCheck:
    """Rounds in which errors are `ratio` times as large while cameras rest, give or take 5 %."""
    rng = np.random.default_rng(0)
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
    assert not after_rounds(RestCheck(), 40, ratio).idle


def test_who_sleeps_when_nobody_should_and_who_is_not_there_say_nothing() -> None:
    late = unknown = RestCheck()
    for slot in range(8 * ROUND):
        late = late.after(slot, SLOT_S, True, 0.03)
        unknown = unknown.after(slot, SLOT_S, not unknown.wakes(slot, SLOT_S), np.nan)
    assert late.rounds == unknown.rounds == 0 and late.operator_note() == ""


def test_no_rest_outlasts_the_time_until_everybody_is_awake() -> None:
    costs = rest_costs([12.5] * 3, [6.25] * 3, [Rest("suspended", 0.5, 0.5, 1.0, 0.2)] * 3)
    everybody = np.ones(3, dtype=bool)
    leave, rest_s = rested(costs, RestMemory.none(3), everybody, 1, 3.0)
    assert leave.all() and rest_s.max() == 3.0
    assert not rested(costs, RestMemory.none(3), everybody, 1, 1.0)[0].any()


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(SceneSettings(scene="one-sided", seconds=30.0, fps=1 / SLOT_S), 702)


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
