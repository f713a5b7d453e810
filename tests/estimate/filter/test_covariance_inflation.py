"""The factor on stated uncertainties."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from e3pose.estimate.filter import Belief, Model
from e3pose.estimate.filter.covariance_inflation import ALONE, STEERED, spread_factor
from e3pose.evaluate.expected_figures import expected_figures
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.noises import load_noise
from e3pose.simulate import SceneSettings, simulate

pytestmark = pytest.mark.slow

SCENES = ("two-rooms", "one-sided", "slow")
SEED = 33
SECONDS, FPS = 12.0, 12.5


def test_joints_that_a_predictor_steers_are_known_better() -> None:
    rig = simulate(SceneSettings("ring", people=1, seconds=0.2, cameras=4), seed=8)
    nobody = Belief.empty(Model(rig.rig, rig.skeleton, load_noise("simulated")))
    assert spread_factor(nobody).shape == (0, len(rig.skeleton))
    shares = np.array([[1.0, 0.4, 2.0]])
    factor = spread_factor(replace(nobody, drift_share=shares))
    np.testing.assert_array_equal(factor, [[ALONE, STEERED, STEERED]])


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
