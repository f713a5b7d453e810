"""Where people come and go: learned from their ends, and what it says of somebody unseen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.estimate.filter.room import ALL, MODEL, run, see, standing, turn
from tests.reference import filter_exits

from e3pose.estimate.filter import Belief, exits
from e3pose.estimate.filter.kernels.exits import place_back
from e3pose.estimate.filter.kernels.shown import hazard_hz
from e3pose.estimate.filter.kernels.step import StepKernel
from e3pose.model.pose import Poses2D

Floats = NDArray[np.float64]

FPS = 12.5
DOOR, MIDDLE = (2.0, 0.0), (-0.5, 0.5)
NOBODY = {camera: Poses2D.empty(17) for camera in ALL}


def walk(start: tuple[float, float], end: tuple[float, float], seconds: float) -> list[Floats]:
    """Return a person `(1, 17, 3)` in every slot of a straight way."""
    steps = np.linspace(0, 1, round(seconds * FPS))[:, None]
    ways = (1 - steps) * np.array(start) + steps * np.array(end)
    return [standing((x, y)) for x, y in ways.tolist()]


def visits(belief: Belief | None, times: int) -> Belief:
    """Let people come in through the door, stand in the middle and leave through the door."""
    for _ in range(times):
        way = [*walk(DOOR, MIDDLE, 2.0), *walk(MIDDLE, MIDDLE, 4.0), *walk(MIDDLE, DOOR, 2.0)]
        belief, _ = run((see(person) for person in way), FPS, belief=belief)
        belief, _ = run([NOBODY] * 20, FPS, belief=belief)
        assert len(belief) == 0
    assert belief is not None
    return belief


@pytest.fixture(scope="module")
def visited() -> Belief:
    return visits(None, 3)


def hazard_at(belief: Belief, place: tuple[float, float]) -> float:
    return hazard_hz(belief.exits, np.array(place), MODEL.corner_m)


def looks_until_hidden(belief: Belief, place: tuple[float, float]) -> int:
    """Return how many looks, of one camera each, miss somebody at a place who is still shown."""
    belief, estimates = run((see(p) for p in walk((0.8, 0.3), place, 2.0)), FPS, belief=belief)
    assert len(estimates[-1]) == 1
    _, estimates = run(({turn(s)[0]: Poses2D.empty(17)} for s in range(8)), FPS, belief=belief)
    return [len(estimate) for estimate in estimates].index(0)


def test_hazard_is_high_where_people_came_and_left_and_low_where_they_stayed(
    visited: Belief,
) -> None:
    assert hazard_at(visited, DOOR) > 10 * exits.PRIOR_HZ
    assert hazard_at(visited, MIDDLE) < exits.PRIOR_HZ
    assert hazard_at(visited, (-3.0, -3.0)) == pytest.approx(exits.PRIOR_HZ)


def test_who_leaves_through_a_learned_door_is_gone_sooner_than_who_is_lost_in_the_middle(
    visited: Belief,
) -> None:
    assert looks_until_hidden(visited, DOOR) == 1
    assert looks_until_hidden(visited, MIDDLE) >= 2
    assert looks_until_hidden(Belief.empty(MODEL), DOOR) >= 2  # nobody knows yet that it is one


def test_who_is_hidden_behind_a_pillar_stays(visited: Belief) -> None:
    """Two of five cameras never show the middle; people there were seen by the others."""
    person = standing(MIDDLE)
    hidden = {0: Poses2D.empty(17), 3: Poses2D.empty(17)}
    belief, _ = run((see(person) | hidden for _ in range(50)), FPS, belief=visited)
    _, estimates = run([hidden] * 2, FPS, belief=belief)
    assert [len(estimate) for estimate in estimates] == [1, 1]
    _, estimates = run([NOBODY] * 2, FPS, belief=belief)
    assert len(estimates[0]) == 0


def test_everybody_who_is_there_at_the_start_came_through_no_door() -> None:
    belief, _ = run((see(standing(MIDDLE)) for _ in range(30)), FPS)
    assert belief.exits[..., exits.PASSED].sum() == 0
    assert belief.exits[..., exits.FOLLOWED].sum() == pytest.approx(29 / FPS, abs=0.2)


def counted(before: Belief, belief: Belief) -> Floats:
    """Return the counts after a slot, which are those of numpy."""
    belief = replace(belief, exits=belief.exits.copy())
    expected = filter_exits.learn(before, belief, MODEL)
    exits.count_slot(before, belief, MODEL)
    np.testing.assert_allclose(belief.exits, expected, rtol=1e-12)
    return belief.exits


def test_a_second_track_of_somebody_there_leaves_through_no_door() -> None:
    belief, _ = run((see(standing(MIDDLE)) for _ in range(10)), FPS)
    columns = {name: np.repeat(c, 2, axis=0) for name, c in belief.columns().items()}
    columns["track_ids"] = np.array([0, 1])
    before = replace(belief, next_id=2, **columns)  # type: ignore[arg-type]
    assert counted(before, belief)[..., exits.PASSED].sum() == 0
    alone = replace(before, **{n: c[:0] for n, c in belief.columns().items()})  # type: ignore[arg-type]
    assert counted(before, alone)[..., exits.PASSED].sum() > 0


def test_a_door_that_is_locked_is_forgotten(visited: Belief) -> None:
    belief, _ = run((see(standing(DOOR)) for _ in range(300)), FPS, belief=visited)
    assert hazard_at(belief, DOOR) < 0.3 * hazard_at(visited, DOOR)
    assert belief.exits[..., exits.FOLLOWED].max() <= exits.MOST_S + 1e-9


def test_place_where_somebody_was_last_measured_is_found_back() -> None:
    way = walk((-1.0, 0.0), (1.0, 0.0), 2.0)
    belief, _ = run((see(person) for person in way), FPS)
    place = belief.state[:, MODEL.tree.levels[0][0], :2]
    later, _ = run([{}] * 4, FPS, belief=belief)
    assert np.linalg.norm(later.state[0, MODEL.tree.levels[0][0], :2] - place) > 0.2
    back_m = np.empty(2)
    root = MODEL.tree.order[0]
    place_back(later.state[0, root], later.last_seen_s[0].min(), back_m)
    np.testing.assert_allclose(back_m, place[0], atol=0.01)


def test_exits_outlast_a_long_pause_and_are_the_same_compiled(visited: Belief) -> None:
    kernel, plain, fast = StepKernel(), visited, visited
    later, _ = run([{}], 0.001, belief=visited)
    np.testing.assert_array_equal(later.exits, visited.exits)
    way = [see(p) for p in walk(MIDDLE, DOOR, 2.0)] + [NOBODY] * 20 + [{}]
    times = [visited.time_s + (i + 1) / FPS for i in range(len(way))]
    times[-1] += 60.0
    for views, time_s in zip(way, times, strict=True):
        plain, _ = run([views], 1 / (time_s - plain.time_s), belief=plain)
        fast, _ = kernel(MODEL, fast, views, time_s)
    assert plain.exits[..., exits.PASSED].sum() > visited.exits[..., exits.PASSED].sum()
    np.testing.assert_allclose(fast.exits, plain.exits, atol=1e-9)
