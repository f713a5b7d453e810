"""A predictor that states its errors makes the estimates better, and no other changes them."""

from __future__ import annotations

import functools
import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.test_estimator_contract import estimator_of

from e3pose.base.arrays import Floats
from e3pose.estimate import ESTIMATORS
from e3pose.estimate.base import STEER_SLOTS, Estimate, History
from e3pose.estimate.filter.estimator import Filtered, Looks
from e3pose.evaluate.replay import ReplaySettings, make_pipeline, replay
from e3pose.evaluate.summary import accuracy
from e3pose.model.pose import Poses2D
from e3pose.pipeline import Pipeline
from e3pose.predict import Prediction
from e3pose.predict.attention_lstm import AttentionLstm
from e3pose.predict.velocities import ConstantVelocity
from e3pose.recording import Recording
from e3pose.settings.parts import STEERING_SLOTS
from e3pose.simulate import SceneSettings, simulate

pytestmark = pytest.mark.slow

CASES = [("two-rooms", 31), ("ring", 32), ("crossing", 31)]
INTERVAL_S = 0.08


@functools.cache
def scene(name: str, seed: int) -> Recording:
    return simulate(SceneSettings(scene=name, seconds=8.0, fps=1 / INTERVAL_S), seed)


@functools.cache
def error_mm(name: str, seed: int, count: int, predictor: str) -> float:
    settings = ReplaySettings(
        policy="round-robin", num_selected=count, predictor=predictor, phase=seed
    )
    recording = scene(name, seed)
    return float(accuracy(recording, list(replay(recording, settings))).mpjpe_mm or np.nan)


@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.nightly)])
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


@dataclass
class Aside:
    """Foresees everybody a little aside, and keeps what it was given."""

    error_m: float
    given: list[tuple[Floats, float, int]] = field(default_factory=list)

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        self.given.append((history_m, interval_s, lead_slots))
        joints = np.repeat(history_m[-1:] + 0.1, lead_slots, axis=0)
        return Prediction(joints, np.full(joints.shape[:-1], self.error_m))


# Slots with a look after the first six, which all have one; slots apart that histories are then.
PACES = [("every slot", 1, 0, 1), ("every fourth", 4, 0, 4), ("three of four", 4, 1, 1)]


@each_case("case", PACES)
def test_people_are_foreseen_by_looks_and_not_by_what_the_filter_expected(
    case: tuple[str, int, int, int],
) -> None:
    _, every, without, pace = case
    recording = scene(*CASES[1])
    estimator, predictor = estimator_of("memory", recording, 8), Aside(0.05)
    memory, shown = estimator.begin(), dict[int, Estimate]()
    for slot in range(60):
        looks = slot < 6 or (slot % every == 0) != bool(without)
        views = {c: recording.view(slot, c) for c in range(len(recording.rig)) if looks}
        seen = {c: view for c, view in views.items() if view is not None}
        memory, estimate = estimator.estimate(memory, seen, slot * INTERVAL_S, lambda: 0.0)
        asked, before = len(predictor.given), memory.belief
        memory = estimator.steer(memory, predictor, INTERVAL_S)
        shown[slot] = estimate
        if slot < 50:
            continue  # the pace of the first slots counts
        if pace > 1 and not looks:
            assert len(predictor.given) == asked and memory.belief is before
            continue
        history_m, interval_s, lead_slots = predictor.given[-1]
        assert interval_s == pytest.approx(pace * INTERVAL_S) and lead_slots == STEER_SLOTS
        for place, at in enumerate(range(slot - 7 * pace, slot + 1, pace)):
            before_m = shown[at].history
            _, found, known = np.intersect1d(
                estimate.history.track_ids, before_m.track_ids, return_indices=True
            )
            assert len(found) > 1
            expected_m = before_m.joints_m[-1, known]
            np.testing.assert_allclose(history_m[place, found], expected_m, atol=1e-9)


def test_looks_that_are_not_even_are_put_on_equal_steps() -> None:
    times_s = np.array([-np.inf, 0.1, 0.2, 0.3, 0.7, 1.1])
    joints_m = np.tile(np.where(times_s > 0, times_s, np.nan)[:, None, None, None], (1, 1, 2, 3))
    looks = Looks(History(np.zeros(1, dtype=np.int64), joints_m), times_s)
    assert looks.pace(0.1) == 4  # the median
    found_m = looks.evenly_m(0.2)[:, 0, 1, 2]
    np.testing.assert_allclose(found_m, [0.1, 0.3, 0.5, 0.7, 0.9, 1.1])
    assert np.isnan(looks.evenly_m(0.4)[:, 0, 0, 0]).tolist() == [True] * 3 + [False] * 3


@each_case("name", sorted(ESTIMATORS))
@each_case("error_m", [0.05, np.nan])
def test_every_estimator_can_be_steered_and_keeps_whom_it_follows(
    name: str, error_m: float
) -> None:
    recording = scene(*CASES[1])
    estimator = estimator_of(name, recording)
    memory = estimator.begin()
    for slot in range(8):
        views = {c: recording.view(slot, c) for c in range(len(recording.rig))}
        seen: Mapping[int, Poses2D] = {c: view for c, view in views.items() if view is not None}
        memory, _ = estimator.estimate(memory, seen, slot * INTERVAL_S, lambda: 0.0)
        steered = estimator.steer(memory, Aside(error_m), INTERVAL_S)
        before, after = (
            estimator.outlook(memory, INTERVAL_S).expected,
            estimator.outlook(steered, INTERVAL_S).expected,
        )
        np.testing.assert_array_equal(before.track_ids, after.track_ids)
        np.testing.assert_array_equal(
            estimator.outlook(memory, 0.0).expected.joints_m,
            estimator.outlook(steered, 0.0).expected.joints_m,
        )
        moved = not np.array_equal(before.joints_m, after.joints_m)
        # A history of less than four slots foretells nothing.
        assert moved == (name == "memory" and np.isfinite(error_m) and slot >= 5) or slot < 5
        memory = steered


def test_nobody_known_is_steered_to_nobody() -> None:
    estimator = estimator_of("memory", scene(*CASES[1]))
    memory, _ = estimator.estimate(estimator.begin(), {}, 0.0, lambda: 0.0)
    steered = estimator.steer(memory, Aside(0.05), INTERVAL_S)
    assert len(estimator.outlook(steered, INTERVAL_S).expected.track_ids) == 0


def made(**changes: Any) -> Pipeline:
    return make_pipeline(scene(*CASES[1]), ReplaySettings(**changes))


@each_case("policy", ["information", "round-robin", "e3pose", "e3pose-mv"])
def test_the_learned_predictor_steers_the_filter_under_every_policy(policy: str) -> None:
    assert isinstance(made(policy=policy).steering, AttentionLstm)
    own = made(policy=policy).predictor
    assert isinstance(own, AttentionLstm) == (policy == "e3pose")


def test_a_predictor_that_is_named_steers_and_no_other_and_the_published_pipeline_never() -> None:
    for name in ("attention-lstm", "constant-velocity"):
        pipeline = made(predictor=name)
        assert pipeline.steering is pipeline.predictor
    assert made(pipeline="paper").steering is None
    assert made(pipeline="paper", predictor="attention-lstm").steering is None


def test_the_pipeline_paper_foresees_with_the_published_network() -> None:
    published = made(pipeline="paper").predictor
    assert isinstance(published, AttentionLstm) and not published.states_error
    others = ("e3pose-mv", "round-robin", "random")
    assert not any(
        isinstance(made(pipeline="paper", policy=policy).predictor, AttentionLstm)
        for policy in others
    )
    own = made(pipeline="paper", predictor="attention-lstm").predictor
    assert isinstance(own, AttentionLstm) and own.states_error


def test_a_better_predictor_steers_from_then_on() -> None:
    better = ConstantVelocity()
    for changes in ({}, {"pipeline": "paper"}):
        pipeline = made(**changes)
        assert pipeline.with_predictor(better).predictor is better
        assert pipeline.with_predictor(better).steering is (better if pipeline.steering else None)


def test_steering_sees_its_whole_history_after_a_short_warm_up() -> None:
    pipeline = made(warmup_slots=1)
    assert isinstance(pipeline.estimator, Filtered)
    assert pipeline.estimator.history_slots >= STEERING_SLOTS


@pytest.mark.parametrize("lead", [1, 30])
def test_steering_does_not_depend_on_how_far_ahead_cameras_are_reported(lead: int) -> None:
    recording = scene(*CASES[1])
    settings = ReplaySettings(policy="all", num_selected=5, lead_slots=lead)
    found = [record.people.joints_m for record in replay(recording, settings)]
    named = replace(settings, predictor="attention-lstm")
    for mine, theirs in zip(found, replay(recording, named), strict=True):
        np.testing.assert_allclose(mine, theirs.people.joints_m, rtol=0, atol=1e-6)


def test_without_weights_the_filter_goes_on_unsteered(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    broken = tmp_path / "no-such-weights.onnx"
    broken.write_bytes(b"nothing")
    monkeypatch.setattr(AttentionLstm.__init__, "__defaults__", (broken,))
    recording = scene(*CASES[1])
    with caplog.at_level(logging.WARNING):
        found = list(replay(recording, ReplaySettings()))
    plain = list(replay(recording, ReplaySettings(predictor="constant-velocity")))
    for mine, theirs in zip(found, plain, strict=True):
        np.testing.assert_array_equal(mine.people.joints_m, theirs.people.joints_m)
    assert [
        r.message
        for r in caplog.records
        if "no-such-weights" in r.message and "unsteered" in r.message
    ]
