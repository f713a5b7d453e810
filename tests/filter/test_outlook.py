"""What is expected of a slot to come: the prediction of the filter itself, by a shorter way."""

from __future__ import annotations

import numpy as np
import pytest

from e3pose.filter import Belief, Model, outlook, step
from e3pose.filter.update import predict
from e3pose.simulate import SceneSettings, simulate

SCENE = simulate(SceneSettings("ring", people=3, seconds=1, cameras=4), seed=8)
MODEL = Model(SCENE.rig, SCENE.skeleton)


@pytest.mark.parametrize("ahead_s", [0.0, 0.04, 0.5])
def test_outlook_is_the_prediction_of_the_filter(ahead_s: float) -> None:
    belief = Belief.empty(MODEL)
    for slot in range(12):
        views = {camera: SCENE.view(slot, camera) for camera in range(4)}
        seen = {camera: view for camera, view in views.items() if view is not None}
        belief, _ = step(MODEL, belief, seen, slot / SCENE.fps)
    assert len(belief) == 3
    found, then = outlook(MODEL, belief, ahead_s), predict(belief, ahead_s, MODEL)
    np.testing.assert_allclose(found.joints_m, then.state[..., :3])
    np.testing.assert_allclose(found.covariance_m2, then.covariance[..., :3, :3], atol=1e-15)
    assert (np.linalg.eigvalsh(found.covariance_m2) > 0).all()
