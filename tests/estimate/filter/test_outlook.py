"""What is expected of a slot to come, steered or not: the filter's prediction by a shorter way."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.room import step
from tests.reference.filter_update import predict

from e3pose.base.arrays import Floats
from e3pose.estimate.filter import Belief, Model, outlook, wait_s
from e3pose.estimate.filter.estimator import GAIN, foreseen, steer
from e3pose.estimate.filter.motion import (
    LEAST_KNOWN_SLOTS,
    LEAST_SHARE,
    MOST_SHARE,
    SQUARES,
    fading,
    places,
)
from e3pose.model.noises import load_noise
from e3pose.predict.base import Prediction
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
    assert len(belief) == 3
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


AHEAD_S = 0.08
SHARE = 0.6


def test_the_prediction_moves_by_the_gain_and_the_positions_stay() -> None:
    belief = followed()
    own_m = places(model().tree, belief.state, AHEAD_S)[..., :3]
    foreseen_m = own_m[[0, 2]] + [0.10, -0.04, 0.02]
    found = steer(model().tree, belief, np.array([0, 2]), foreseen_m, AHEAD_S, SHARE)
    moved = places(model().tree, found.state, AHEAD_S)[..., :3] - own_m
    np.testing.assert_allclose(moved[[0, 2]], GAIN * (foreseen_m - own_m[[0, 2]]), atol=1e-12)
    np.testing.assert_array_equal(found.state[1], belief.state[1])
    np.testing.assert_array_equal(found.state[..., :3], belief.state[..., :3])
    np.testing.assert_array_equal(found.covariance, belief.covariance)
    np.testing.assert_array_equal(found.drift_share[[0, 2]], SHARE)
    np.testing.assert_array_equal(found.drift_share[1], 1.0)


def test_joints_that_nobody_foresees_keep_their_velocity_and_others_move_all_the_same() -> None:
    belief = followed()
    own_m = places(model().tree, belief.state, AHEAD_S)[0, :, :3]
    foreseen_m = own_m[None] + 0.1
    foreseen_m[0, 5] = np.nan
    foreseen_m[0, 6, 2] = np.nan
    found = steer(model().tree, belief, np.array([0]), foreseen_m, AHEAD_S, SHARE)
    np.testing.assert_array_equal(found.state[0, 5:7], belief.state[0, 5:7])
    moved_m = places(model().tree, found.state, AHEAD_S)[0, :, :3] - own_m
    np.testing.assert_allclose(np.delete(moved_m, [5, 6], axis=0), GAIN * 0.1, atol=1e-12)
    np.testing.assert_array_equal(found.drift_share[0, 5:7], 1.0)
    np.testing.assert_array_equal(found.drift_share[0, :5], SHARE)


@pytest.mark.parametrize(("joints_m", "ahead_s"), [(np.nan, AHEAD_S), (1.0, 0.0)])
def test_without_a_prediction_or_time_people_move_by_themselves(
    joints_m: float, ahead_s: float
) -> None:
    belief = followed()
    steered = replace(belief, drift_share=np.full_like(belief.drift_share, SHARE))
    foreseen_m = np.full((1, len(model().skeleton), 3), joints_m)
    found = steer(model().tree, steered, np.array([0]), foreseen_m, ahead_s, SHARE)
    np.testing.assert_array_equal(found.state, belief.state)
    np.testing.assert_array_equal(found.drift_share, belief.drift_share)


def test_less_is_unknown_of_motion_that_is_predicted() -> None:
    belief = followed()
    foreseen_m = places(model().tree, belief.state, AHEAD_S)[..., :3][:1]
    steered = steer(model().tree, belief, np.array([0]), foreseen_m, AHEAD_S, SHARE)
    time_s = belief.time_s + AHEAD_S
    alone, found = (step(model(), each, {}, time_s)[0] for each in (belief, steered))
    apart = alone.covariance - found.covariance
    assert (np.linalg.eigvalsh(apart[0])[:, 1:] > 0).all()
    np.testing.assert_array_equal(apart[1:], 0.0)
    outlooks = [outlook(model(), each, 0.0).expected.drift_m2ps3 for each in (belief, steered)]
    np.testing.assert_allclose(outlooks[1][0], SHARE * outlooks[0][0])


def grown(shares: float, interval_s: float) -> Floats:
    """Return errors of two slots that grow by a share of what the filter's motion leaves open."""
    drift, lasts_s = model().alone
    first, second = (3 * fading(drift, lasts_s, n * interval_s)[1][:, 0, 0] for n in (1, 2))
    error_m = np.full((2, 1, len(drift)), 0.02)
    error_m[1] = np.sqrt(error_m[0] ** 2 + shares * (second - first) / SQUARES)
    return error_m


def foreseen_of(
    error_m: Floats, interval_s: float, history_m: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return what steers of a prediction with these errors, of people who are well known."""
    shape = error_m.shape[1:]
    history_m = np.zeros((LEAST_KNOWN_SLOTS, *shape, 3)) if history_m is None else history_m
    prediction = Prediction(np.ones((len(error_m), *shape, 3)), error_m)
    return foreseen(model(), history_m, prediction, interval_s)


@each_case("interval_s", [1 / 60, 0.04, 0.2])
def test_noise_is_left_where_the_predictor_foresees_its_error_to_grow(interval_s: float) -> None:
    for shares, expected in ((0.0, LEAST_SHARE), (0.3, LEAST_SHARE + 0.3), (9.0, MOST_SHARE)):
        joints_m, found = foreseen_of(grown(shares, interval_s), interval_s)
        np.testing.assert_allclose(found, expected, rtol=1e-9)
        np.testing.assert_array_equal(joints_m, 1.0)
    shrinking = foreseen_of(grown(0.5, interval_s)[::-1].copy(), interval_s)[1]
    np.testing.assert_array_equal(shrinking, LEAST_SHARE)


def test_joints_without_a_stated_error_and_people_just_met_are_not_steered() -> None:
    error_m = grown(0.3, 0.04)
    error_m[:, 0, 4] = np.nan
    joints_m, _ = foreseen_of(error_m, 0.04)
    assert np.flatnonzero(np.isnan(joints_m[0, :, 0])).tolist() == [4]
    history_m = np.zeros((6, 1, 17, 3))
    history_m[: 7 - LEAST_KNOWN_SLOTS] = np.nan
    history_m[-1, 0, :16] = np.nan  # one joint is enough
    assert np.isnan(foreseen_of(grown(0.3, 0.04), 0.04, history_m)[0]).all()
    history_m[6 - LEAST_KNOWN_SLOTS] = 0.0
    assert np.isfinite(foreseen_of(grown(0.3, 0.04), 0.04, history_m)[0]).all()
