"""Steered velocities: what is expected moves half way to what is foreseen, what is known stays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from tests.estimate.filter.room import step

from e3pose.estimate.filter import Belief, Model
from e3pose.estimate.filter.motion import places
from e3pose.estimate.filter.steer import GAIN, steer
from e3pose.model.pose import Poses2D
from e3pose.simulate import SceneSettings, simulate

SCENE = simulate(SceneSettings("ring", people=3, seconds=1, cameras=4), seed=8)
MODEL = Model(SCENE.rig, SCENE.skeleton)
# Without swing: how far limbs swing depends on the speed of the root, which is steered, too.
TREE = replace(MODEL.tree, swing_per_s2=np.zeros(len(MODEL.skeleton)))
AHEAD_S = 0.08


def views_of(slot: int) -> Mapping[int, Poses2D]:
    views = {camera: SCENE.view(slot, camera) for camera in range(4)}
    return {camera: view for camera, view in views.items() if view is not None}


def known() -> Belief:
    belief = Belief.empty(MODEL)
    for slot in range(12):
        belief, _ = step(MODEL, belief, views_of(slot), slot / SCENE.fps)
    assert len(belief) == 3
    return belief


def test_the_prediction_moves_by_the_gain_and_the_positions_stay() -> None:
    belief = known()
    own_m = places(TREE, belief.state, AHEAD_S)[..., :3]
    foreseen_m = own_m[[0, 2]] + [0.10, -0.04, 0.02]
    found = steer(TREE, belief, np.array([0, 2]), foreseen_m, AHEAD_S)
    moved = places(TREE, found.state, AHEAD_S)[..., :3] - own_m
    np.testing.assert_allclose(moved[[0, 2]], GAIN * (foreseen_m - own_m[[0, 2]]), atol=1e-12)
    np.testing.assert_array_equal(found.state[1], belief.state[1])
    np.testing.assert_array_equal(found.state[..., :3], belief.state[..., :3])
    np.testing.assert_array_equal(found.covariance, belief.covariance)


def test_joints_that_nobody_foresees_keep_their_velocity() -> None:
    belief = known()
    foreseen_m = places(TREE, belief.state, AHEAD_S)[..., :3][:1] + 0.1
    foreseen_m[0, 5] = np.nan
    foreseen_m[0, 6, 2] = np.nan
    found = steer(TREE, belief, np.array([0]), foreseen_m, AHEAD_S)
    np.testing.assert_array_equal(found.state[0, 5:7], belief.state[0, 5:7])
    assert (found.state[0, :5, 3:] != belief.state[0, :5, 3:]).all()


@pytest.mark.parametrize(("joints_m", "ahead_s"), [(np.nan, AHEAD_S), (1.0, 0.0)])
def test_without_a_prediction_or_time_the_belief_is_the_same(
    joints_m: float, ahead_s: float
) -> None:
    belief = known()
    foreseen_m = np.full((1, len(MODEL.skeleton), 3), joints_m)
    assert steer(TREE, belief, np.array([0]), foreseen_m, ahead_s) is belief
