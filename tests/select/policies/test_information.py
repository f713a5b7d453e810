"""The policy that looks for information: what it prefers, what it pays, what it aims at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case
from tests.select import outlooks
from tests.select.outlooks import standing

from e3pose.energy.queues import advance_deficit, price
from e3pose.select.expected_information import Entrants, Foresight
from e3pose.select.policies import Selection, Situation
from e3pose.select.policies.information import MAX_PAUSE_S, Information
from e3pose.select.stated_error import StatedError

pytestmark = pytest.mark.slow

EYE = np.array([1.0, 0, 0, 1, 0, 1])


def foresight(added: list[float], sigma_m: float = 0.1, **more: object) -> Foresight:
    """One person of one joint, known to `sigma_m`; camera n adds `added[n]` in 1/m2."""
    views = np.array(added)[:, None, None, None] * EYE
    plain = Foresight(
        outlook=standing(np.zeros((1, 1, 3)), len(added)),
        prior=(EYE / sigma_m**2)[None, None],
        views=views,
        counted=np.ones((len(added), 1)),
        new=np.ones((len(added), 1)),
        weights=np.ones(1),
        entrants=Entrants.none(len(added)),
    )
    return replace(plain, **more)  # type: ignore[arg-type]


def situation(seen: Foresight, **more: object) -> Situation:
    return outlooks.situation(len(seen.views), foresight=seen, **more)


def chosen(selection: Selection) -> list[int]:
    return [int(camera) for camera in np.flatnonzero(selection)]


def test_takes_who_tells_most_unless_its_queue_asks_too_much() -> None:
    seen = foresight([10, 300, 200, 20])
    policy = Information(2, quality_weight=10)
    assert chosen(policy.select(situation(seen))) == [1, 2]
    tired = np.array([0.0, 50.0, 0.0, 0.0])
    assert chosen(policy.select(situation(seen, price=tired))) == [2, 3]


def test_two_cameras_from_different_sides_beat_the_two_best_from_one() -> None:
    along_x, along_y = np.array([0, 0, 0, 1.0, 0, 1]), np.array([1.0, 0, 0, 0, 0, 1])
    seen = foresight([1, 1, 1])
    views = np.stack([900 * along_x, 800 * along_x, 500 * along_y])[:, None, None]
    assert chosen(Information(2).select(situation(replace(seen, views=views)))) == [0, 2]


def test_a_camera_that_just_showed_the_same_waits() -> None:
    seen = foresight([300, 290], new=np.array([[0.1], [1.0]]))
    assert chosen(Information(1).select(situation(seen))) == [1]


def test_a_camera_that_has_not_looked_for_long_is_looked_through() -> None:
    seen = foresight([100, 0, 0])
    policy = Information(1, quality_weight=10)
    assert chosen(policy.select(situation(seen))) == [0]
    unseen = np.array([1, 200, 3])
    assert chosen(policy.select(situation(seen, unseen_slots=unseen))) == [1]


def test_somebody_unexplained_pulls_in_cameras_that_see_the_same_ground() -> None:
    nobody_else = np.zeros((1, 3))
    new = Entrants(np.array([[0.0, 1.0, 0.9]]), nobody_else, np.ones(1))
    seen = foresight([30, 25, 0], sigma_m=0.05, entrants=new)
    plain = situation(foresight([30, 25, 0], sigma_m=0.05))
    assert chosen(Information(1, phase=2).select(plain)) == [0]  # whose turn it is
    assert chosen(Information(1).select(situation(seen))) == [1]
    assert chosen(Information(2).select(situation(seen))) == [1, 2]
    aiming = Information(1, target_error_m=1.0)
    assert len(chosen(aiming.select(situation(seen)))) == 2
    met = foresight([30, 25, 0], sigma_m=0.05, entrants=new._replace(weights=np.array([0.1])))
    assert chosen(Information(2, phase=1).select(situation(met))) == [0, 1]
    assert chosen(aiming.select(situation(met))) == []


def test_cameras_whose_turn_it_is_win_unless_others_are_clearly_better() -> None:
    for turn in range(3):
        alike = situation(foresight([100, 95, 98]), slot=turn)
        assert chosen(Information(1).select(alike)) == [turn]
        better = situation(foresight([300, 95, 98]), slot=turn)
        assert chosen(Information(1).select(better)) == [0]
    rounds = Information(1, order=(2, 0, 1))
    assert chosen(rounds.select(situation(foresight([100, 95, 98]), slot=0))) == [2]


def test_turns_leave_out_cameras_far_ahead_of_their_budgets_where_others_suffice() -> None:
    policy, tired = Information(1), np.array([0.0, 1000.0, 0.0])
    now = situation(foresight([100, 100, 100]), slot=1)
    assert chosen(policy.select(now)) == [1]
    assert chosen(policy.select(replace(now, deficit=tired))) == [2]
    assert chosen(Information(3).select(replace(now, deficit=tired))) == [0, 1, 2]


@each_case("seed", range(6))
@each_case("count", [2, 4])
def test_many_cameras_are_chosen_greedily_within_the_guarantee(seed: int, count: int) -> None:
    from itertools import combinations

    rng = np.random.default_rng(seed)
    root = rng.normal(size=(12, 2, 5, 2, 3)) * rng.uniform(0, 30, (12, 2, 1, 1, 1))
    full = np.einsum("...ka,...kb->...ab", root, root)
    rows, columns = np.triu_indices(3)
    seen = Foresight(
        outlook=standing(np.zeros((2, 5, 3)), 12),
        prior=np.tile(EYE * 100, (2, 5, 1)),
        views=np.ascontiguousarray(full[..., rows, columns]),
        counted=np.ones((12, 2)),
        new=np.ones((12, 2)),
        weights=np.array([1.0, 0.4]),
        entrants=Entrants.none(12),
    )
    now = situation(seen, price=rng.uniform(0, 5, 12))
    selection = Information(count, quality_weight=10).select(now)
    assert selection.sum() == count
    subsets = np.array([np.isin(np.arange(12), c) for c in combinations(range(12), count)])
    # The objective that is zero for no camera and grows with each: prices against the highest.
    worth = now.price.max() - now.price
    worth = worth + 10 * 0.5 * 0.04  # all have waited one slot

    def value(sets: NDArray[np.bool_]) -> NDArray[np.float64]:
        return np.asarray(10 * seen.information(sets) + sets @ worth)

    reached, best = float(value(selection[None])[0]), float(value(subsets).max())
    assert reached >= (1 - 1 / np.e) * best
    assert reached >= 0.9 * best  # the guarantee is for the worst case; this is a usual one


def test_the_fewest_cameras_that_meet_the_target() -> None:
    seen = foresight([300.0] * 5, sigma_m=0.05)
    errors = [float(seen.expected_error_m((np.arange(5) < count)[None])[0]) for count in range(6)]
    for needed in range(6):
        policy = Information(3, target_error_m=errors[needed] * 1.001)
        assert policy.select(situation(seen)).sum() == needed
    # The lower the rate, the less is known of the next slot, and the more cameras are needed.
    rates = (situation(foresight([300.0] * 6, sigma_m)) for sigma_m in (0.02, 0.04, 0.08, 0.3))
    counts = [int(Information(3, target_error_m=0.04).select(at).sum()) for at in rates]
    assert counts == sorted(counts) and counts[0] == 0 and counts[-1] > counts[1]
    # Beyond reach: as many as still help, and these help all alike.
    assert Information(3, target_error_m=0.001).select(situation(seen)).sum() == 5


def test_slots_take_turns_between_two_numbers_for_a_target_between() -> None:
    seen = foresight([300.0] * 5, sigma_m=0.05)
    errors = [float(seen.expected_error_m((np.arange(5) < count)[None])[0]) for count in (2, 1)]
    target_m = 0.3 * errors[0] + 0.7 * errors[1]
    policy = Information(3, target_error_m=target_m)
    counts = [policy.select(situation(seen, slot=slot)).sum() for slot in range(200)]
    assert set(counts) == {1, 2}
    expected = np.mean([errors[0] if count == 2 else errors[1] for count in counts])
    assert expected == pytest.approx(target_m, rel=0.01)


def test_what_was_stated_moves_the_number_of_cameras() -> None:
    seen = foresight([300.0] * 6)
    errors = [float(seen.expected_error_m(np.arange(6)[None] < n)[0]) for n in range(1, 6)]
    policy = Information(3, target_error_m=errors[2] * 1.001)

    def count(mean_m: float, filled: float = 0.9) -> int:
        stated = StatedError(mean_m, filled)
        return int(policy.select(situation(seen, stated=stated)).sum())

    assert count(errors[0], filled=0.0) == count(errors[2]) == 3
    assert count(errors[0]) > 3 > count(errors[4])


def test_cameras_that_no_longer_help_stay_asleep_when_the_target_is_beyond_reach() -> None:
    seen = foresight([900, 800, 0.1, 0.1, 0.1])
    assert chosen(Information(3, target_error_m=0.001).select(situation(seen))) == [0, 1]


def test_with_a_target_somebody_always_looks_now_and_then() -> None:
    nobody = Foresight(
        standing(np.zeros((0, 1, 3)), 3), np.zeros((0, 1, 6)), np.zeros((3, 0, 1, 6)),
        np.zeros((3, 0)), np.zeros((3, 0)), np.zeros(0), Entrants.none(3),
    )  # fmt: skip
    policy = Information(3, target_error_m=0.04)
    assert not policy.select(situation(nobody)).any()
    stale = np.full(3, round(MAX_PAUSE_S / 0.04))
    assert policy.select(situation(nobody, unseen_slots=stale)).sum() == 1


@pytest.mark.parametrize("target_error_m", [None, 0.02])
def test_unequal_budgets_are_kept_in_the_long_run(target_error_m: float | None) -> None:
    rng = np.random.default_rng(5)
    budget = np.array([0.05, 0.3, 0.5, 0.8])
    policy = Information(1.5, quality_weight=10, target_error_m=target_error_m)
    deficit, active, num_slots = np.zeros(4), np.zeros(4), 4000
    for slot in range(num_slots):
        seen = foresight((rng.uniform(0, 900, 4) * [3, 1, 1, 1]).tolist())
        now = situation(seen, slot=slot, deficit=deficit, price=deficit, budget=budget)
        selection = policy.select(now)
        deficit = advance_deficit(deficit, budget, selection)
        assert (deficit >= 0).all()
        active += selection
    assert (active / num_slots <= budget + 0.02).all()


def test_a_dearer_camera_is_woken_less() -> None:
    rng = np.random.default_rng(6)
    cost_j, budget = np.array([3.0, 1.0, 1.0]), np.full(3, 0.36)
    policy = Information(1, quality_weight=1)
    deficit, active = np.zeros(3), np.zeros(3)
    for slot in range(3000):
        seen = foresight(rng.uniform(0, 500, 3).tolist())
        asked = price(deficit, cost_j)
        selection = policy.select(situation(seen, slot=slot, price=asked, budget=budget))
        deficit = advance_deficit(deficit, budget, selection)
        active += selection
    assert active[0] < active[1:].min()


@each_case("quality_weight", [1.0, 10.0])
@each_case("others", [0, 60])  # all sets are tried; one camera after the other
def test_nearly_equal_cameras_take_turns_by_the_phase(others: int, quality_weight: float) -> None:
    def taken(better: float) -> list[list[int]]:
        seen = foresight([300.0, 300.0 * better] + [0.0] * others)
        policies = (Information(1, quality_weight, phase=phase) for phase in range(2))
        return [chosen(policy.select(situation(seen, slot=6))) for policy in policies]

    assert taken(1.0005) == [[0], [1]]  # by 0.0006 nats
    assert taken(1.4) == [[1], [1]]  # by 0.3 nats
