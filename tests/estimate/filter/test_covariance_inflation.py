"""The factor on stated uncertainties, and what innovations make of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.estimate.filter.room import MODEL, NUM_CAMERAS, run, step
from tests.estimate.filter.test_learned_noise import FPS as ROOM_FPS
from tests.estimate.filter.test_learned_noise import stated, walking
from tests.interpreted import interpreted

from e3pose.estimate.filter import Belief, covariance_inflation
from e3pose.estimate.filter.covariance_inflation import (
    ALONE,
    EXPECTED,
    MEMORY_S,
    MOST,
    PRIOR_M,
    STEERED,
    USUAL,
)
from e3pose.estimate.filter.outlook import stated_factor
from e3pose.evaluate.figures import expected_figures
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.simulate import SceneSettings, simulate

pytestmark = pytest.mark.slow

learned_factor = interpreted(covariance_inflation.learned_factor)
spread_factor = interpreted(covariance_inflation.spread_factor)

SCENES = ("two-rooms", "one-sided", "slow")
SEED = 33
SECONDS, FPS = 12.0, 12.5
QUIET = np.ones(NUM_CAMERAS)


@pytest.mark.parametrize(
    "predictor",
    ["attention-lstm", pytest.param("constant-velocity", marks=pytest.mark.nightly)],
)
def test_the_error_stated_is_the_error_made(predictor: str) -> None:
    ratios, within = [], []
    for scene in SCENES:
        fps = None if scene == "slow" else FPS
        recording = simulate(SceneSettings(scene=scene, seconds=SECONDS, fps=fps), SEED)
        for cameras in (1, 2, 4):
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
    expected_m = 1e4 * PRIOR_M
    for times, factor in ((1.0, 1.0), (1.2, 1.2), (0.0, 1 / MOST), (100.0, MOST)):
        taught = np.array([times * USUAL * expected_m, expected_m])
        assert learned_factor(taught) == pytest.approx(factor, rel=0.001)
    assert learned_factor(np.zeros(2)) == 1.0
    factors = [spread_factor(share, 1.0) for share in (1.0, 0.4, 2.0)]
    assert factors == [ALONE, STEERED, STEERED]  # joints that a predictor steers are known better
    little = np.array([1.2 * USUAL * PRIOR_M / 10, PRIOR_M / 10])
    assert 1.0 < learned_factor(little) < 1.05


def test_everybody_has_a_factor_of_which_the_mean_is_expected_of_all() -> None:
    nobody = Belief.empty(MODEL)
    assert stated_factor(nobody) == 1.0
    walking_m, still_m = np.array([[1.5 * USUAL, 1.0], [0.7 * USUAL, 1.0]]) * 1e4
    people = replace(
        nobody,
        drift_share=np.array([[1.0, 0.4]] * 2),
        innovations=np.stack([walking_m, still_m]),
        last_seen_s=np.zeros((2, NUM_CAMERAS)),
        confirmed=np.array([True, False]),
    )
    assert stated_factor(people) == pytest.approx(1.5 * (ALONE + STEERED) / 2, rel=1e-3)
    everybody = replace(people, confirmed=np.ones(2, dtype=bool))
    assert stated_factor(everybody) == pytest.approx(1.1 * (ALONE + STEERED) / 2, rel=1e-3)


def test_people_who_stand_still_are_stated_to_be_known_better_than_walkers() -> None:
    moving, still = (
        learned_factor(
            run(walking(8.0, QUIET, "turn", radius_m=radius_m), fps=ROOM_FPS)[0].innovations[0]
        )
        for radius_m in (1.0, 0.0)
    )
    assert 1 / MOST <= still < 0.9 * moving < MOST


@pytest.mark.parametrize("times", [0.5, 2.0])
def test_wrong_noise_changes_it_little_once_the_noise_is_learned(times: float) -> None:
    """What is wrong with the noise is learned as noise; the rest is a quarter at most."""
    slots = walking(16.0, QUIET, "turn")
    right = learned_factor(run(slots, fps=ROOM_FPS)[0].innovations[0])
    wrong = learned_factor(run(slots, fps=ROOM_FPS, model=stated(times))[0].innovations[0])
    assert wrong == pytest.approx(right, rel=0.25)


def test_what_is_learned_of_people_fades_while_nobody_sees_them() -> None:
    belief, _ = run(walking(4.0, QUIET), fps=ROOM_FPS)
    assert (belief.innovations[:, EXPECTED] > PRIOR_M).all()
    later, _ = step(MODEL, belief, {}, belief.time_s + 0.3)
    left = np.exp(-0.3 / MEMORY_S)
    np.testing.assert_allclose(later.innovations, left * belief.innovations)
