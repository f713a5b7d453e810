"""What every policy promises, over every entry of POLICIES."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.cases import each_case
from tests.select import outlooks
from tests.select.outlooks import standing

from e3pose.energy.queues import advance_deficit
from e3pose.select.expected_information import Entrants, Foresight
from e3pose.select.policies import POLICIES, PolicySettings, Promise, Selection, Situation

NAMES = sorted(POLICIES)
COUNTING = [name for name in NAMES if Promise.COUNT in POLICIES[name].promises]
BUDGETED = [name for name in NAMES if Promise.BUDGET in POLICIES[name].promises]


def foresight(rng: np.random.Generator, num_cameras: int) -> Foresight:
    """Two people of three joints, about whom every camera tells something else."""
    root = rng.normal(size=(num_cameras, 2, 3, 2, 3))
    views = np.einsum("...ka,...kb->...ab", root, root) * 1000
    rows, columns = np.triu_indices(3)
    return Foresight(
        outlook=standing(np.zeros((2, 3, 3)), num_cameras),
        prior=np.tile([400.0, 0, 0, 400, 0, 400], (2, 3, 1)),
        views=np.ascontiguousarray(views[..., rows, columns]),
        counted=np.ones((num_cameras, 2)),
        new=np.ones((num_cameras, 2)),
        weights=np.ones(2),
        entrants=Entrants.none(num_cameras),
    )


def situation(slot: int, rng: np.random.Generator, online: Selection) -> Situation:
    num_cameras = len(online)
    deficit = rng.uniform(0, 4, num_cameras)
    return outlooks.situation(
        num_cameras,
        slot=slot,
        online=online,
        occlusion=rng.uniform(0, 1, num_cameras),
        own_occlusion=np.where(rng.uniform(size=num_cameras) < 0.2, np.nan, rng.uniform(0, 0.3)),
        unseen_slots=rng.integers(1, 40, num_cameras),
        visibility=rng.uniform(0, 1, (num_cameras, 3)),
        deficit=deficit,
        price=deficit,
        foresight=foresight(rng, num_cameras),
    )


@each_case("name", NAMES)
def test_never_selects_an_offline_camera(name: str) -> None:
    rng = np.random.default_rng(1)
    policy = POLICIES[name].make(PolicySettings(num_selected=3))
    for slot in range(200):
        online = rng.uniform(size=6) < 0.6
        selection = policy.select(situation(slot, rng, online))
        assert selection.shape == online.shape and selection.dtype == bool
        assert not (selection & ~online).any()


@pytest.mark.parametrize("name", COUNTING)
@settings(max_examples=50)
@given(data=st.data())
def test_selects_exactly_as_many_as_promised(name: str, data: st.DataObject) -> None:
    num_cameras = data.draw(st.integers(1, 12))
    count = data.draw(st.integers(1, num_cameras))
    online = np.array(
        data.draw(st.lists(st.booleans(), min_size=num_cameras, max_size=num_cameras))
    )
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    policy = POLICIES[name].make(PolicySettings(num_selected=count, phase=3, seed=4))
    selection = policy.select(situation(data.draw(st.integers(0, 10_000)), rng, online))
    assert selection.sum() == min(count, online.sum())


@each_case("name", COUNTING)
@each_case("mean", [0.65, 0.9, 1.15, 1.5, 2.0, 3.3])
def test_reaches_a_mean_that_is_no_whole_number(name: str, mean: float) -> None:
    policy = POLICIES[name].make(PolicySettings(num_selected=mean))
    rng, online = np.random.default_rng(3), np.ones(5, dtype=bool)
    online[2] = False
    counts = [int(policy.select(situation(slot, rng, online)).sum()) for slot in range(200)]
    assert abs(sum(counts) - 200 * mean) <= 1
    assert set(counts) <= {int(mean), int(mean) + 1}


@pytest.mark.slow
@each_case("name", BUDGETED)
@each_case("budget", [0.6, 0.9])
def test_keeps_the_budget_in_the_long_run(name: str, budget: float) -> None:
    # Camera 0 is always the clearest and camera 4 the worst, so that a policy that looks at the
    # scene would like to spend far too much on the first ones.
    rng = np.random.default_rng(2)
    policy = POLICIES[name].make(PolicySettings(num_selected=3, quality_weight=5.0))
    online, deficit, active = np.ones(5, dtype=bool), np.zeros(5), np.zeros(5)
    num_slots = 1000
    for slot in range(num_slots):
        now = replace(
            situation(slot, rng, online),
            occlusion=np.linspace(0.0, 0.5, 5),
            own_occlusion=np.zeros(5),
            deficit=deficit,
            price=deficit,
            budget=np.full(5, budget),
        )
        selection = policy.select(now)
        deficit = advance_deficit(deficit, now.budget, selection)
        active += selection
    # A random draw strays by three standard deviations of its mean; nothing else may.
    slack = 3 * np.sqrt(0.6 * 0.4 / num_slots) if name == "random" else 0.005
    assert (active / num_slots <= budget + slack).all()


@each_case("name", NAMES)
def test_the_same_seed_and_situation_give_the_same_selection(name: str) -> None:
    """No hidden memory: a policy made anew in the middle of a run goes on as the old one would."""
    online = np.array([True, True, False, True, True])
    situations = [situation(slot, np.random.default_rng(slot), online) for slot in range(30)]
    old = POLICIES[name].make(PolicySettings(num_selected=2, seed=5))
    whole_run = [old.select(now) for now in situations]
    new = POLICIES[name].make(PolicySettings(num_selected=2, seed=5))
    np.testing.assert_array_equal([new.select(now) for now in situations[15:]], whole_run[15:])


def test_seeds_of_random_differ() -> None:
    online = np.ones(5, dtype=bool)
    runs = []
    for seed in (0, 1):
        policy = POLICIES["random"].make(PolicySettings(num_selected=2, seed=seed))
        rng = np.random.default_rng(0)
        runs.append([policy.select(situation(slot, rng, online)) for slot in range(20)])
    assert (np.array(runs[0]) != np.array(runs[1])).any()


def test_round_robin_follows_its_order_without_a_gap() -> None:
    policy = POLICIES["round-robin"].make(PolicySettings(num_selected=1.5, order=(0, 3, 1, 4, 2)))
    rng, online = np.random.default_rng(0), np.ones(5, dtype=bool)
    taken = [
        set(np.flatnonzero(policy.select(situation(slot, rng, online))).tolist())
        for slot in range(4)
    ]
    assert taken == [{0}, {3, 1}, {4}, {2, 0}]


def test_round_robin_turns_through_all_cameras_and_skips_the_dead() -> None:
    policy = POLICIES["round-robin"].make(PolicySettings(num_selected=2))
    rng = np.random.default_rng(0)
    online = np.array([True, False, True, True, True])
    counts = sum(policy.select(situation(slot, rng, online)).astype(int) for slot in range(20))
    np.testing.assert_array_equal(counts, [10, 0, 10, 10, 10])


def test_drift_plus_penalty_takes_the_least_of_weighted_occlusion_and_deficit() -> None:
    rng = np.random.default_rng(0)
    now = replace(
        situation(0, rng, np.ones(4, dtype=bool)),
        occlusion=np.array([0.5, 0.1, 0.0, 0.3]),
        price=np.array([0.0, 0.3, 1.0, 0.1]),
    )
    # V = 1: prices .5 .4 1. .4; V = 10: 5. 1.3 1. 3.1
    expected = {1.0: [False, True, False, True], 10.0: [False, True, True, False]}
    for weight, selection in expected.items():
        policy = POLICIES["e3pose"].make(PolicySettings(num_selected=2, quality_weight=weight))
        np.testing.assert_array_equal(policy.select(now), selection)


def test_independent_may_leave_a_slot_without_any_camera() -> None:
    rng = np.random.default_rng(0)
    now = replace(
        situation(0, rng, np.ones(3, dtype=bool)),
        own_occlusion=np.full(3, 0.4),
        unseen_slots=np.array([1, 2, 3]),
        deficit=np.zeros(3),
    )
    policy = POLICIES["independent"].make(PolicySettings())
    assert not policy.select(now).any()
    assert policy.select(replace(now, unseen_slots=np.array([1, 99, 3]))).tolist() == [
        False,
        True,
        False,
    ]


def test_independent_within_its_budget_looks_while_it_is_a_slot_ahead_at_most() -> None:
    rng = np.random.default_rng(0)
    now = replace(
        situation(0, rng, np.ones(3, dtype=bool)),
        own_occlusion=np.array([0.0, 0.0, 0.06]),
        unseen_slots=np.ones(3, dtype=int),
        deficit=np.array([1.0, 1.01, 0.0]),
    )
    policy = POLICIES["independent"].make(PolicySettings(independent_queue=True))
    assert policy.select(now).tolist() == [True, False, False]


def test_central_2d_drops_the_slots_that_pass_while_cameras_wait() -> None:
    rng = np.random.default_rng(0)
    policy = POLICIES["central-2d"].make(PolicySettings(num_selected=2, round_trip_s=0.1))
    online = np.ones(5, dtype=bool)
    counts = [int(policy.select(situation(slot, rng, online)).sum()) for slot in range(6)]
    assert counts == [2, 0, 0, 2, 0, 0]  # 0.1 s are three slots of 0.04 s


@each_case("name", ["e3pose", "e3pose-mv", "central-2d"])
def test_quality_weight_means_the_same_at_every_site(name: str) -> None:
    """Where people hide each other a tenth as much, V weighs what it weighs elsewhere."""
    rng = np.random.default_rng(4)
    policy = POLICIES[name].make(PolicySettings(num_selected=2, quality_weight=1.5))
    for slot in range(0, 200, 2):
        here = situation(slot, rng, np.ones(6, dtype=bool))
        here = replace(here, spread=float(here.occlusion.std()))
        there = replace(
            here,
            occlusion=0.1 * here.occlusion,
            own_occlusion=0.1 * here.own_occlusion,
            spread=0.1 * here.spread,
        )
        np.testing.assert_array_equal(policy.select(here), policy.select(there))


def test_one_spread_of_occlusion_is_worth_as_many_active_slots_as_the_weight() -> None:
    here = situation(10, np.random.default_rng(0), np.ones(2, dtype=bool))
    here = replace(here, occlusion=np.array([0.05, 0.02]), spread=0.03)
    for queue, better in ((1.4, 1), (1.6, 0)):  # the clearer camera has run ahead by so much
        asked = replace(here, price=np.array([0.0, queue]))
        policy = POLICIES["e3pose"].make(PolicySettings(num_selected=1, quality_weight=1.5))
        assert policy.select(asked)[better]


def test_large_weights_come_near_the_least_occlusion_and_let_queues_grow() -> None:
    """The O(1/V) gap and the O(V) queue of Lyapunov optimisation, with three of five cameras."""
    rng = np.random.default_rng(0)
    occlusions = rng.uniform(0, 0.2, 5) + rng.uniform(0, 0.1, (3000, 5))
    gaps, queues = [], []
    for weight in (0.3, 3.0, 30.0):
        policy = POLICIES["e3pose"].make(PolicySettings(num_selected=3, quality_weight=weight))
        deficit, duty, total, longest = np.zeros(5), np.zeros(5), 0.0, 0.0
        here = situation(0, rng, np.ones(5, dtype=bool))
        for slot, occlusion in enumerate(occlusions):
            at = replace(
                here, slot=slot, occlusion=occlusion, spread=0.06, deficit=deficit, price=deficit
            )
            selection = policy.select(at)
            deficit = advance_deficit(deficit, np.full(5, 0.8), selection)
            duty += selection / len(occlusions)
            total += occlusion[selection].sum() / len(occlusions)
            longest = max(longest, float(deficit.max()))
        gaps.append(total)
        queues.append(longest)
        assert duty.max() < 0.8 + longest / len(occlusions)
    assert gaps[0] > gaps[1] > gaps[2]
    assert queues[0] < queues[1] < queues[2]
    assert queues[2] < 10 * queues[1] + 1  # no faster than V
