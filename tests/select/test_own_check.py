"""The check of a policy on itself: what it compares, when it falls back, when it tries again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from e3pose.evaluate.replay import ReplaySettings, make_pipeline, selected_views
from e3pose.model.pose import Poses2D
from e3pose.pipeline import SlotState, initial_state, step
from e3pose.recording import Recording
from e3pose.select import own_check, rounds
from e3pose.select.own_check import SELECTING, TURNS, OwnCheck, distance_m
from e3pose.select.rounds import LEAST_ROUNDS, STRETCH_S, STRETCHES
from e3pose.simulate import SceneSettings, simulate

pytestmark = pytest.mark.slow

SLOT_S = 0.08
ROUND = round(STRETCH_S * STRETCHES / SLOT_S)


@pytest.mark.parametrize("num_cameras", [2, 3, 4, 5, 6, 8, 12])
def test_turns_are_tried_for_a_sixteenth_of_the_time_and_all_cameras_compare(
    num_cameras: int,
) -> None:
    plans = [OwnCheck().plan(slot, SLOT_S, num_cameras) for slot in range(ROUND)]
    assert np.mean([plan.way == TURNS for plan in plans]) == pytest.approx(1 / STRETCHES)
    for way in (SELECTING, TURNS):
        slots = [slot for slot, plan in enumerate(plans) if plan.counts and plan.way == way]
        turns = np.bincount(np.array(slots) % num_cameras, minlength=num_cameras)
        assert turns.max() - turns.min() <= 1


def after_rounds(check: OwnCheck, count: int, ratio: float, seed: int = 0) -> OwnCheck:
    """Rounds in which a selection is `ratio` times as far off as turns, give or take a tenth."""
    rng = np.random.default_rng(seed)
    first = check.round * ROUND
    for slot in range(first, first + count * ROUND + 1):
        plan = check.plan(slot, SLOT_S, 5)
        seen_m = error_m = np.nan
        if plan.counts:
            seen_m = 0.05 * (ratio if plan.way == SELECTING else 1.0) * np.exp(rng.normal(0, 0.1))
            error_m = 0.03 if plan.way == SELECTING else 0.04
        check = check.after(slot, SLOT_S, plan.way, seen_m, error_m)
    return check


def test_falls_back_where_turns_are_nearer_and_selects_again_where_they_are_not() -> None:
    assert not after_rounds(OwnCheck(), LEAST_ROUNDS - 1, 1.3).by_turns  # too early to say
    behind = after_rounds(OwnCheck(), 8, 1.2)
    assert behind.by_turns
    assert np.expm1(behind.mean) == pytest.approx(0.2, abs=0.05)
    assert -np.expm1(behind.stated) == pytest.approx(0.25)
    assert "take turns" in behind.words() and "+21% ± 2% by views, -25% stated" in behind.words()
    assert behind.plan(behind.round * ROUND, SLOT_S, 5).way == TURNS
    assert np.mean(
        [behind.plan(slot, SLOT_S, 5).way == SELECTING for slot in range(ROUND)]
    ) == pytest.approx(1 / STRETCHES)
    again = after_rounds(behind, 40, 0.8)
    assert not again.by_turns and "take turns" not in again.words()


@pytest.mark.parametrize("seed", range(5))
def test_stays_where_a_selection_is_nearer_or_as_near(seed: int) -> None:
    for ratio in (0.8, 1.0):
        assert not after_rounds(OwnCheck(), 40, ratio, seed).by_turns


def test_a_round_without_views_says_nothing() -> None:
    check = OwnCheck()
    for slot in range(10 * ROUND):
        check = check.after(slot, SLOT_S, SELECTING, np.nan, 0.03)
    assert check.rounds == 0 and check.words() == ""


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(SceneSettings(scene="two-rooms", seconds=100.0, fps=1 / SLOT_S), 701)


def test_distance_is_that_of_keypoints_at_the_depth_of_the_person(recording: Recording) -> None:
    pipeline = make_pipeline(recording, ReplaySettings(policy="all", lead_slots=1))
    state = initial_state(pipeline)
    online = np.ones(len(recording.rig), dtype=bool)
    for slot in range(40):
        views = selected_views(recording, slot, online)
        state, _ = step(pipeline, state, views, online)
    outlook = pipeline.estimator.outlook(state.memory, SLOT_S)
    joints_m = outlook.joints_m[outlook.confirmed]
    camera = next(
        n for n, each in enumerate(recording.rig.cameras) if each.sees(joints_m).all(axis=1).any()
    )
    lens = recording.rig.cameras[camera]
    for off_m in (0.0, 0.1):
        pixels = lens.project(joints_m + off_m * lens.R[0])
        scores = np.isfinite(pixels).all(axis=-1).astype(float)
        view = Poses2D(np.where(scores[..., None] > 0, pixels, np.nan), scores)
        found_m = distance_m(recording.rig, outlook, {camera: view}, online)
        assert found_m == pytest.approx(off_m, rel=0.02, abs=1e-6)
        assert np.isnan(distance_m(recording.rig, outlook, {camera: view}, ~online))


@dataclass(frozen=True)
class Overconfident:
    """An estimator whose outlook takes one camera for a hundred times better than it is."""

    real: Any

    def __getattr__(self, name: str) -> Any:
        return getattr(self.real, name)

    def outlook(self, memory: Any, ahead_s: float) -> Any:
        outlook = self.real.outlook(memory, ahead_s)
        sigma_px = outlook.sigma_px.copy()
        sigma_px[0] /= 100
        return replace(outlook, sigma_px=sigma_px)


def last_state(recording: Recording) -> tuple[SlotState, str, list[int]]:
    """Replay with quick rounds; return the state, what is said and who was selected."""
    settings = ReplaySettings(policy="information", num_selected=1, lead_slots=4, budget=1.0)
    pipeline = make_pipeline(recording, settings)
    pipeline = replace(pipeline, estimator=Overconfident(pipeline.estimator))
    state, online = initial_state(pipeline), np.ones(len(recording.rig), dtype=bool)
    chosen, words = [], ""
    for slot in range(recording.num_slots):
        views = selected_views(recording, slot, state.selections[0])
        state, record = step(pipeline, state, views, online)
        assert record.reasons is not None
        words = record.reasons.check
        chosen += np.flatnonzero(record.next_selection).tolist()
    return state, words, chosen


def test_a_policy_whose_model_is_wrong_falls_back_to_turns(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("STRETCH_S", 2.5), ("STRETCHES", 4), ("SETTLE_S", 0.5)):
        for module in (own_check, rounds):
            monkeypatch.setattr(module, name, value)
    state, words, chosen = last_state(recording)
    assert state.check.by_turns and "take turns" in words
    assert np.mean(np.array(chosen[:300]) == 0) > 0.5


def test_by_turns_for_as_long_as_turns_are_nearer() -> None:
    check = after_rounds(OwnCheck(), 8, 1.2)
    for seed in range(4):
        assert check.by_turns
        check = after_rounds(check, 1, 1.2, seed)
