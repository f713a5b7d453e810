"""What is expected of a slot to come: the prediction of the filter itself, by a shorter way."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.room import step
from tests.reference.filter_update import predict

from e3pose.estimate.filter import Belief, Model, outlook, wait_s
from e3pose.model.noises import load_noise
from e3pose.recording import Recording
from e3pose.select.expected_information import foresee
from e3pose.simulate import SceneSettings, simulate

SIMULATED = load_noise("simulated")


@cache
def scene() -> Recording:
    return simulate(SceneSettings("ring", people=3, seconds=1, cameras=4), seed=8)


@cache
def model() -> Model:
    return Model(scene().rig, scene().skeleton, SIMULATED)


@cache
def followed() -> Belief:
    belief = Belief.empty(model())
    for slot in range(12):
        views = {camera: scene().view(slot, camera) for camera in range(4)}
        seen = {camera: view for camera, view in views.items() if view is not None}
        belief, _ = step(model(), belief, seen, slot / scene().fps)
    return belief


def test_a_factor_is_on_all_that_is_uncertain() -> None:
    plain = outlook(model(), followed(), 0.2).expected
    twice = outlook(model(), followed(), 0.2, factor=2.0).expected
    np.testing.assert_allclose(twice.covariance, 4 * plain.covariance)
    np.testing.assert_allclose(twice.drift_m2ps3, 4 * plain.drift_m2ps3)
    np.testing.assert_allclose(twice.sigma_px, 2 * plain.sigma_px)
    np.testing.assert_array_equal(twice.joints_m, plain.joints_m)


@each_case("ahead_s", [0.0, 0.04, 0.5])
def test_outlook_is_the_prediction_of_the_filter(ahead_s: float) -> None:
    belief = followed()
    assert len(belief) == 3
    found, then = outlook(model(), belief, ahead_s), predict(belief, ahead_s, model())
    np.testing.assert_allclose(found.expected.joints_m, then.state[..., :3])
    if ahead_s > 0:
        nobody = np.zeros((0, len(scene().rig)), dtype=bool)
        prior = foresee(scene().rig, found, ahead_s, nobody).prior
        rows, columns = np.triu_indices(3)
        inverse = np.empty((*prior.shape[:2], 3, 3))
        inverse[..., rows, columns] = inverse[..., columns, rows] = prior
        spread = np.trace(np.linalg.inv(inverse), axis1=-2, axis2=-1)
        expected = np.trace(then.covariance[..., :3, :3], axis1=-2, axis2=-1)
        # Every joint is carried by itself, as one process for all that its body does.
        assert (np.sqrt(spread / expected) > 0.95).all()
        assert (np.sqrt(spread / expected) < 1.1).all()
        root = model().tree.levels[0][0]
        np.testing.assert_allclose(spread[:, root], expected[:, root], rtol=1e-6)


def test_only_the_newest_look_of_a_camera_says_who_is_unexplained() -> None:
    """Two people seen three times by a camera are two people."""
    belief = Belief.empty(model())
    for slot in range(3):
        view = scene().view(slot, 1)
        assert view is not None
        belief, _ = step(model(), belief, {1: view}, slot / scene().fps)
    assert len(belief.leftovers) == 6
    found = outlook(model(), belief, 0.1)
    assert found.unexplained.tolist() == [0, 2, 0, 0]
    assert found.unexplained_s.tolist() == [np.inf, 0.0, np.inf, np.inf]


@each_case(
    ("interval_s", "num_selected", "expected_s"),
    [(0.04, 2, 0.14), (0.04, 0.4, 0.3), (0.08, 1, 0.2), (0.2, 1, 0.5), (0.2, 0.5, 1.0)],
)
def test_a_detection_waits_until_another_camera_can_have_looked(
    interval_s: float, num_selected: float, expected_s: float
) -> None:
    assert wait_s(interval_s, num_selected) == pytest.approx(expected_s)
