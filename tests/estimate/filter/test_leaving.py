"""People whom nobody sees any more: they have left, or are hidden."""

from __future__ import annotations

from tests.estimate.filter.room import ALL, run, see, standing, turn

from e3pose.estimate.filter import Belief
from e3pose.model.pose import Poses2D

FPS = 12.5
MIDDLE = (-0.5, 0.5)
NOBODY = {camera: Poses2D.empty(17) for camera in ALL}


def standing_there(hidden: dict[int, Poses2D]) -> Belief:
    """Return the belief of somebody who stands in the middle; some cameras never show it."""
    person = standing(MIDDLE)
    belief, _ = run((see(person) | hidden for _ in range(50)), FPS)
    return belief


def test_who_is_missed_in_plain_sight_is_soon_gone() -> None:
    looks = ({turn(slot)[0]: Poses2D.empty(17)} for slot in range(8))
    _, estimates = run(looks, FPS, belief=standing_there({}))
    assert 2 <= [len(estimate) for estimate in estimates].index(0) <= 4


def test_who_is_hidden_behind_a_pillar_stays() -> None:
    """Two of five cameras never show the middle; people there were seen by the others."""
    hidden = {0: Poses2D.empty(17), 3: Poses2D.empty(17)}
    belief, estimates = run([hidden] * 2, FPS, belief=standing_there(hidden))
    assert [len(estimate) for estimate in estimates] == [1, 1]
    _, estimates = run([NOBODY] * 2, FPS, belief=belief)
    assert len(estimates[0]) == 0
