"""The factor on stated uncertainties, and what innovations make of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.estimate.filter.room import MODEL, NUM_CAMERAS, run, step
from tests.estimate.filter.test_learned_noise import FPS as ROOM_FPS
from tests.estimate.filter.test_learned_noise import stated, walking
from tests.reference.belief_arrays import belief_from_arrays, belief_to_arrays

from e3pose.estimate.filter import Belief
from e3pose.estimate.filter.covariance_inflation import (
    ALONE,
    COUNT,
    MOST,
    STEERED,
    USUAL,
)
from e3pose.estimate.filter.kernels.covariance_inflation import learned_factor, spread_factor
from e3pose.estimate.filter.outlook import stated_factor
from e3pose.evaluate.expected_figures import expected_figures
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.simulate import SceneSettings, simulate

pytestmark = pytest.mark.slow

SCENES = ("two-rooms", "one-sided", "slow")
SEED = 33
SECONDS, FPS = 12.0, 12.5
QUIET = np.ones(NUM_CAMERAS)


def test_joints_that_a_predictor_steers_are_known_better() -> None:
    factors = [spread_factor(share, 1.0) for share in (1.0, 0.4, 2.0)]
    assert factors == [ALONE, STEERED, STEERED]


@pytest.mark.parametrize("predictor", ["attention-lstm", "constant-velocity"])
def test_the_error_stated_is_the_error_made(predictor: str) -> None:
    ratios, within = [], []
    for scene in SCENES:
        fps = None if scene == "slow" else FPS
        recording = simulate(SceneSettings(scene=scene, seconds=SECONDS, fps=fps), SEED)
        for cameras in (1, 2):
            settings = ReplaySettings(num_selected=cameras, lead_slots=4, predictor=predictor)
            found = expected_figures(recording, list(replay(recording, settings)))
            assert found.matched_mm is not None
            assert found.actual_mm is not None
            assert found.coverage_90 is not None
            ratios.append(found.matched_mm / found.actual_mm)
            within.append(found.coverage_90)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.15)
    assert np.mean(within) == pytest.approx(90, abs=4)


def test_the_factor_is_the_constant_until_innovations_teach_and_then_theirs() -> None:
    assert learned_factor(np.zeros(2)) == 1.0
    assert learned_factor(np.array([USUAL, 1e4])) == pytest.approx(1.0)
    assert learned_factor(np.array([1.2 * USUAL, 1e4])) == pytest.approx(1.2, rel=0.01)
    assert learned_factor(np.array([1.2 * USUAL, 10.0])) < 1.05
    assert learned_factor(np.array([0.0, 1e4])) == 1 / MOST
    assert learned_factor(np.array([100.0, 1e4])) == MOST


def test_it_is_on_all_that_is_stated() -> None:
    nobody = Belief.empty(MODEL)
    assert stated_factor(nobody) == 1.0
    one = replace(nobody, drift_share=np.array([[1.0, 0.4]]), confirmed=np.ones(1, dtype=bool))
    assert stated_factor(one) == pytest.approx((ALONE + STEERED) / 2)
    taught = replace(one, innovations=np.array([1.5 * USUAL, 1e4]))
    assert stated_factor(taught) == pytest.approx(1.5 * stated_factor(one), rel=0.01)


def test_people_who_stand_still_are_stated_to_be_known_better_than_walkers() -> None:
    moving, still = (
        learned_factor(
            run(walking(8.0, QUIET, "turn", radius_m=radius_m), fps=ROOM_FPS)[0].innovations
        )
        for radius_m in (1.0, 0.0)
    )
    assert 1 / MOST <= still < 0.9 * moving < MOST


@pytest.mark.parametrize("times", [0.5, 2.0])
def test_wrong_noise_changes_it_little_once_the_noise_is_learned(times: float) -> None:
    """What is wrong with the noise is learned as noise; the rest is a quarter at most."""
    slots = walking(16.0, QUIET, "turn")
    right = learned_factor(run(slots, fps=ROOM_FPS)[0].innovations)
    wrong = learned_factor(run(slots, fps=ROOM_FPS, model=stated(times))[0].innovations)
    assert wrong == pytest.approx(right, rel=0.25)


def test_what_is_learned_outlasts_people_and_pauses() -> None:
    belief, _ = run(walking(4.0, QUIET), fps=ROOM_FPS)
    assert belief.innovations[COUNT] > 0
    later, _ = step(MODEL, belief, {}, belief.time_s + 60)
    assert len(later) == 0
    np.testing.assert_array_equal(later.innovations, belief.innovations)
    again = belief_from_arrays(belief_to_arrays(later), MODEL)
    np.testing.assert_array_equal(again.innovations, belief.innovations)


def test_ghosts_of_one_camera_teach_nothing() -> None:
    belief, _ = run(walking(4.0, QUIET), fps=ROOM_FPS)
    alone = [{0: slot[0]} for slot in walking(8.0, QUIET)[50:]]
    late, _ = run(alone[:13], fps=ROOM_FPS, belief=belief)
    after, _ = run(alone[13:], fps=ROOM_FPS, belief=late)
    np.testing.assert_array_equal(after.innovations, late.innovations)
