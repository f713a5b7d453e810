"""Who is shown, motion and steering: the compiled form against plain numpy."""

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
