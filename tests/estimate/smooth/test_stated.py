"""What smoothers state of their errors: part by part, and against truth."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from e3pose.estimate.base import People, Posterior, Start
from e3pose.estimate.smooth.stated import MOST, SHARED, SPAN, USUAL, Lasting, own_m2, repeated_m2
from e3pose.evaluate.expected_figures import expected_figures
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.smoothed import smooth_records
from e3pose.simulate import DetectorSettings, SceneSettings, simulate
from e3pose.simulate.settings import Guessing

pytestmark = pytest.mark.slow


def posterior(time_s: float, share: float) -> Posterior:
    none, nobody = np.zeros(0, dtype=np.int64), np.zeros((0, 17))
    state, wide = np.zeros((0, 17, 6)), np.zeros((0, 17, 6, 6))
    places, start = wide[..., :3, :3], Start(np.nan, none, state, nobody)
    return Posterior(
        time_s, none, none, state, wide, wide, nobody, nobody, start, nobody, places, places, share
    )


def test_biases_count_as_far_as_they_are_larger_than_usual() -> None:
    def after(share: float, seconds: float = 30.0) -> Lasting:
        found = Lasting()
        for time_s in np.arange(0.0, seconds, 0.1):
            found = found.after(posterior(float(time_s), share))
        return found

    assert after(USUAL / 2).excess == 0.0
    assert after(USUAL + SPAN / 2).excess == pytest.approx(0.5, abs=0.01)
    assert after(9.0).excess == MOST
    assert 0 < after(USUAL + SPAN, 0.35).excess < after(USUAL + SPAN).excess
    begun = after(USUAL + SPAN)
    assert begun.after(posterior(30.1, np.nan)).excess == pytest.approx(begun.excess)
    assert replace(begun, time_s=99.0).after(posterior(3.0, 0.0)).excess == begun.excess


def test_parts_are_between_those_of_filter_and_smoother() -> None:
    before, after, f = 4.0 * np.eye(3), np.eye(3), np.array(2.0)
    np.testing.assert_allclose(own_m2(before, after, f, 0.0), 4 * after)
    np.testing.assert_allclose(own_m2(before, after, f, 1.0), 4 * (1 + 3 * SHARED) * np.eye(3))
    np.testing.assert_allclose(repeated_m2(after, before, 0.0), after)
    np.testing.assert_allclose(repeated_m2(after, before, 1.0), before)


@cache
def coverage(errors: str, cameras: int) -> tuple[float, float]:
    """Return the percentage of joints in the 90 % radius with a lag of 80 ms, and with all."""
    guessing = Guessing() if errors == "situation" else None
    detector = DetectorSettings(guessing=guessing)
    settings = SceneSettings("pillar", seconds=16, fps=12.5, detector=detector)
    recording = simulate(settings, seed=703)
    people: list[People] = []
    asked = ReplaySettings(num_selected=cameras, phase=1, seed=1)
    records = list(replay(recording, asked, publish=people.append))
    posteriors = [each.posterior for each in people if each.posterior is not None]
    found = [
        expected_figures(
            recording, smooth_records(records, posteriors, recording.skeleton, lag)
        ).coverage_90
        for lag in (1, None)
    ]
    assert found[0] is not None and found[1] is not None
    return found[0], found[1]


@pytest.mark.parametrize("errors", ["score", "situation"])
@pytest.mark.parametrize("cameras", [1, 5])
def test_nine_of_ten_joints_are_within_the_radius_stated(errors: str, cameras: int) -> None:
    for share in coverage(errors, cameras):
        assert 84 <= share <= 96, coverage(errors, cameras)
