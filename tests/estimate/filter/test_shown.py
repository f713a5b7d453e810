"""Who is shown: not those whom cameras look for and miss, nor whom one camera alone leads."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.room import MODEL, run, see, standing
from tests.reference import filter_motion, filter_shown

from e3pose.estimate.filter import Belief
from e3pose.estimate.filter.estimator import steer
from e3pose.estimate.filter.motion import places
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


def test_nobody_is_hidden_because_no_camera_looks() -> None:
    _, estimates = run([{}] * 2, FPS, belief=followed())
    assert [len(estimate) for estimate in estimates] == [1, 1]


def test_nobody_is_shown_of_nobody() -> None:
    assert shown(Belief.empty(MODEL), MODEL).shape == (0,)


def test_somebody_new_needs_a_third_camera() -> None:
    belief, estimates = run([see(PLACE, (0, 2))], FPS)
    assert len(estimates[0]) == 0
    _, estimates = run([see(PLACE, (3,))], FPS, belief=belief)
    assert len(estimates[0]) == 1


PEOPLE = 6


@pytest.fixture(scope="module")
def follower() -> Belief:
    belief, _ = run((see(standing((0.3, 0.2))) for _ in range(20)), 12.5)
    return belief


def drawn(follower: Belief, seed: int) -> Belief:
    """Return people of whom nothing goes together: some lost, some walking, some vague."""
    rng = np.random.default_rng(seed)
    cameras = len(MODEL.rig)
    row = np.zeros(PEOPLE, dtype=np.int64)
    columns: dict[str, Any] = {name: c[row] for name, c in follower.columns().items()}
    belief = replace(follower, **columns)
    seen = rng.uniform(0, 1.5, (PEOPLE, cameras)) * (rng.random((PEOPLE, cameras)) < 0.8)
    return replace(
        belief,
        track_ids=np.arange(PEOPLE),
        state=belief.state + rng.normal(0, 0.4, belief.state.shape),
        covariance=belief.covariance * rng.uniform(1, 3000, (PEOPLE, 1, 1, 1)),
        confirmed=rng.random(PEOPLE) < 0.8,
        last_seen_s=np.where(rng.random(seen.shape) < 0.1, np.inf, seen),
        missed=rng.uniform(0, 3, seen.shape),
        detection_map=rng.uniform(0, 30, belief.detection_map.shape) * [1, 0.5],
    )


@each_case("seed", range(10))
def test_who_is_shown_is_as_in_numpy(follower: Belief, seed: int) -> None:
    belief = drawn(follower, seed)
    np.testing.assert_array_equal(shown(belief, MODEL), filter_shown.shown(belief, MODEL))


@each_case("seed", range(5))
def test_bodies_move_and_are_steered_as_in_numpy(follower: Belief, seed: int) -> None:
    rng = np.random.default_rng(seed)
    belief = drawn(follower, seed)
    for dt in (0.0, 0.04, 0.5):
        found = places(MODEL.tree, belief.state, dt)
        expected = filter_motion.places(MODEL.tree, belief.state, dt)
        np.testing.assert_allclose(found, expected, atol=1e-12)
    joints_m = belief.state[[1, 4], :, :3] + rng.normal(0, 0.1, (2, len(MODEL.skeleton), 3))
    joints_m[rng.random(joints_m.shape[:2]) < 0.3] = np.nan
    share = rng.uniform(0.4, 2, joints_m.shape[:2])
    arguments = (MODEL.tree, belief, np.array([1, 4]), joints_m, 0.08, share)
    found_belief, expected_belief = steer(*arguments), filter_shown.steer(*arguments)
    np.testing.assert_allclose(found_belief.state, expected_belief.state, atol=1e-12)
    np.testing.assert_array_equal(found_belief.drift_share, expected_belief.drift_share)
