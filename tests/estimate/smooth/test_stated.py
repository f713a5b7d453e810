"""What smoothers state of their errors: part by part, and against truth."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.estimate.base import Estimate
from e3pose.estimate.filter.lasting import grown_m2
from e3pose.estimate.smooth.bodies import SHARED, own_m2
from e3pose.evaluate.figures import expected_figures
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.smoothed import smooth_records
from e3pose.simulate import DetectorSettings, SceneSettings, simulate
from e3pose.simulate.settings import Guessing

pytestmark = pytest.mark.slow


def test_parts_are_between_those_of_filter_and_smoother() -> None:
    before, after, f = 4.0 * np.eye(3), np.eye(3), np.array(2.0)
    np.testing.assert_allclose(own_m2(before, after, f, 0.0), 4 * after)
    np.testing.assert_allclose(own_m2(before, after, f, 1.0), 4 * (1 + 3 * SHARED) * np.eye(3))
    np.testing.assert_allclose(grown_m2(after, before, 0.0), after)
    np.testing.assert_allclose(grown_m2(after, before, 1.0), before)


@cache
def coverage(errors: str, cameras: int) -> tuple[float, ...]:
    """Return the percentage of joints in the 90 % radius: at once, 80 ms later, by all slots."""
    guessing = Guessing() if errors == "situation" else None
    detector = DetectorSettings(guessing=guessing)
    settings = SceneSettings("pillar", seconds=13, fps=12.5, detector=detector)
    recording = simulate(settings, seed=703)
    people: list[Estimate] = []
    asked = ReplaySettings(num_selected=cameras, phase=1, seed=1)
    records = list(replay(recording, asked, publish=people.append))
    posteriors = [each.posterior for each in people if each.posterior is not None]
    made = [records]
    for lag in (1, None):
        made.append([*smooth_records(records, posteriors, recording.skeleton, lag)])
    return tuple(expected_figures(recording, each).coverage_90 or 0.0 for each in made)


@each_case("errors, cameras", [("score", 1), ("situation", 5)])
def test_nine_of_ten_joints_are_within_the_radius_stated(errors: str, cameras: int) -> None:
    for share in coverage(errors, cameras):
        assert 84 <= share <= 96, coverage(errors, cameras)
