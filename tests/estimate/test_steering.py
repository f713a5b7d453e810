"""A predictor that states its errors makes the estimates better, and no other changes them."""

from __future__ import annotations

import functools
from collections.abc import Mapping

import numpy as np
import pytest

from e3pose.estimate import ESTIMATORS, EstimatorSettings, make_estimator
from e3pose.estimate.base import STEER_SLOTS
from e3pose.estimate.per_slot.fuse import FusionSettings
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import accuracy
from e3pose.model.pose import Poses2D
from e3pose.predict import Prediction
from e3pose.recording import Recording
from e3pose.simulate import SceneSettings, simulate

CASES = [("two-rooms", 31), ("ring", 32), ("crossing", 31)]
INTERVAL_S = 0.08


@functools.cache
def scene(name: str, seed: int) -> Recording:
    return simulate(SceneSettings(scene=name, seconds=10.0, fps=1 / INTERVAL_S), seed)


@functools.cache
def error_mm(name: str, seed: int, count: int, predictor: str) -> float:
    settings = ReplaySettings(
        policy="round-robin", num_selected=count, predictor=predictor, phase=seed
    )
    recording = scene(name, seed)
    return float(accuracy(recording, list(replay(recording, settings)))["mpjpe_mm"])


@pytest.mark.parametrize("count", [1, 2])
def test_the_learned_predictor_lowers_the_error(count: int) -> None:
    ratios = [
        error_mm(*case, count, "attention-lstm") / error_mm(*case, count, "damped-velocity")
        for case in CASES
    ]
    assert max(ratios) < 1.0
    assert np.mean(ratios) < 0.9


def test_predictors_that_state_no_error_change_nothing() -> None:
    name, seed = CASES[0]
    still = error_mm(name, seed, 1, "zero-velocity")
    assert error_mm(name, seed, 1, "constant-velocity") == still


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
@pytest.mark.parametrize("error_m", [0.05, np.nan])
def test_every_estimator_can_be_steered_and_keeps_whom_it_follows(
    name: str, error_m: float
) -> None:
    recording = scene(*CASES[1])
    settings = EstimatorSettings(recording.rig, recording.skeleton, INTERVAL_S, 5, FusionSettings())
    estimator = make_estimator(name, settings)
    memory = estimator.begin()
    for slot in range(8):
        views = {c: recording.view(slot, c) for c in range(len(recording.rig))}
        seen: Mapping[int, Poses2D] = {c: view for c, view in views.items() if view is not None}
        memory, people = estimator.estimate(memory, seen, slot * INTERVAL_S, lambda: 0.0)
        joints = np.repeat(people.history_m[-1:] + 0.1, STEER_SLOTS, axis=0)
        prediction = Prediction(joints, np.full(joints.shape[:-1], error_m))
        steered = estimator.steer(memory, prediction, INTERVAL_S)
        before, after = (
            estimator.outlook(memory, INTERVAL_S),
            estimator.outlook(steered, INTERVAL_S),
        )
        np.testing.assert_array_equal(before.track_ids, after.track_ids)
        np.testing.assert_array_equal(
            estimator.outlook(memory, 0.0).joints_m, estimator.outlook(steered, 0.0).joints_m
        )
        moved = not np.array_equal(before.joints_m, after.joints_m)
        # A history of less than four slots foretells nothing.
        assert moved == (name == "memory" and np.isfinite(error_m) and slot >= 5) or slot < 5
        memory = steered


def test_nobody_known_is_steered_to_nobody() -> None:
    recording = scene(*CASES[1])
    settings = EstimatorSettings(recording.rig, recording.skeleton, INTERVAL_S, 5, FusionSettings())
    estimator = make_estimator("memory", settings)
    memory, people = estimator.estimate(estimator.begin(), {}, 0.0, lambda: 0.0)
    nothing = np.zeros((STEER_SLOTS, 0, 17, 3))
    assert people.history_m.shape[1] == 0
    steered = estimator.steer(memory, Prediction(nothing, nothing[..., 0]), INTERVAL_S)
    assert len(estimator.outlook(steered, INTERVAL_S)) == 0
