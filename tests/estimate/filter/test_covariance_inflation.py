"""The factor on stated uncertainties: its laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.estimate.filter.room import step

from e3pose.estimate.filter import Belief, Model
from e3pose.estimate.filter.covariance_inflation import spread_factor
from e3pose.model.pose import Poses2D
from e3pose.simulate import SceneSettings, simulate

SCENE = simulate(SceneSettings("ring", people=2, seconds=1, cameras=4), seed=8)
MODEL = Model(SCENE.rig, SCENE.skeleton)


@pytest.fixture(scope="module")
def belief() -> Belief:
    found = Belief.empty(MODEL)
    for slot in range(SCENE.num_slots):
        views: dict[int, Poses2D] = {}
        for camera in range(4):
            view = SCENE.view(slot, camera)
            if view is not None:
                views[camera] = view
        found, _ = step(MODEL, found, views, slot / SCENE.fps)
    assert len(found) >= 1
    return found


def test_typical_people_need_little_correction(belief: Belief) -> None:
    factor = spread_factor(belief, MODEL)
    assert factor.shape == belief.unmeasured_s.shape
    assert (factor > 0.6).all()
    assert (factor < 1.4).all()


def test_who_walks_or_was_not_seen_is_less_certain(belief: Belief) -> None:
    state = belief.state.copy()
    state[..., 3:] = 0.0
    still = replace(belief, state=state)
    moving = state.copy()
    moving[..., 3] = 1.0
    assert (spread_factor(replace(belief, state=moving), MODEL) > spread_factor(still, MODEL)).all()
    unseen = replace(still, unmeasured_s=np.full_like(belief.unmeasured_s, 0.4))
    measured = replace(still, unmeasured_s=np.zeros_like(belief.unmeasured_s))
    assert (spread_factor(unseen, MODEL) > spread_factor(measured, MODEL)).all()


def test_images_of_more_pixels_change_nothing_but_wider_ones_do(belief: Belief) -> None:
    cameras = []
    for camera in SCENE.rig.cameras:
        K = camera.K * np.array([[2.0], [2.0], [1.0]])
        width, height = camera.image_size
        cameras.append(replace(camera, K=K, image_size=(2 * width, 2 * height)))
    larger = Model(type(SCENE.rig)(tuple(cameras)), SCENE.skeleton)
    np.testing.assert_allclose(spread_factor(belief, larger), spread_factor(belief, MODEL))
    wide = [
        replace(camera, K=camera.K * np.array([[0.5], [0.5], [1.0]]))
        for camera in SCENE.rig.cameras
    ]
    wider = Model(type(SCENE.rig)(tuple(wide)), SCENE.skeleton)
    assert (spread_factor(belief, wider) < spread_factor(belief, MODEL)).all()


def test_who_no_camera_has_seen_is_finite(belief: Belief) -> None:
    never = replace(
        belief,
        last_seen_s=np.full_like(belief.last_seen_s, np.inf),
        unmeasured_s=np.full_like(belief.unmeasured_s, np.inf),
    )
    assert np.isfinite(spread_factor(never, MODEL)).all()
    nobody = Belief.empty(MODEL)
    assert spread_factor(nobody, MODEL).shape == (0, len(SCENE.skeleton))
