"""Who is shown: not those whom cameras look for and miss, nor whom one camera alone leads."""

from __future__ import annotations

from tests.estimate.filter.room import MODEL, run, see, standing

from e3pose.estimate.filter import Belief
from e3pose.estimate.filter.shown import shown
from e3pose.model.pose import Poses2D

FPS = 12.5
PLACE = standing((0.3, 0.2))


def followed() -> Belief:
    belief, _ = run((see(PLACE) for _ in range(20)), FPS)
    return belief


def test_a_track_missed_in_plain_sight_is_hidden_and_found_again_with_the_same_id() -> None:
    miss = {camera: Poses2D.empty(17) for camera in (0, 2)}
    belief, estimates = run([miss] * 2, FPS, belief=followed())
    assert [len(estimate) for estimate in estimates] == [1, 0]
    assert belief.track_ids.tolist() == [1]  # it is followed
    _, estimates = run([see(PLACE, (1,))], FPS, belief=belief)
    assert estimates[0].track_ids.tolist() == [1]
    _, estimates = run([{}] * 2, FPS, belief=followed())  # nobody is hidden as no camera looks
    assert [len(estimate) for estimate in estimates] == [1, 1]
    assert shown(Belief.empty(MODEL), MODEL).shape == (0,)


def test_somebody_new_needs_a_third_camera() -> None:
    belief, estimates = run([see(PLACE, (0, 2))], FPS)
    assert len(estimates[0]) == 0
    _, estimates = run([see(PLACE, (3,))], FPS, belief=belief)
    assert len(estimates[0]) == 1
