"""Keypoint noise has the sizes, tails and memory measured on Shelf."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.model.noise import ErrorMemory
from e3pose.simulate import DetectorSettings, SceneSettings, simulate
from e3pose.simulate.noise import correlated, normal_cdf, size_scale

pytestmark = pytest.mark.slow


# Measured on Shelf: scores, median residual in pixels, share beyond 40 pixels.
MEASURED = [
    (0.15, 16.6, 0.19), (0.25, 14.9, 0.17), (0.35, 14.0, 0.13), (0.45, 11.1, 0.065),
    (0.55, 9.6, 0.032), (0.65, 7.6, 0.027), (0.75, 5.5, 0.013), (0.85, 3.7, 0.009),
    (0.95, 2.7, 0.004),
]  # fmt: skip
AUTOCORRELATION = {
    1: 0.77,
    2: 0.65,
    3: 0.58,
    5: 0.49,
    8: 0.41,
    12: 0.35,
    20: 0.30,
    30: 0.26,
    50: 0.21,
}


@lru_cache(maxsize=1)
def noisy() -> tuple[Floats, Floats]:
    """Errors (num_slots, num_series, 2) and scores of people seen at Shelf's scale, by identity.

    One person per recording, so that the detection needs no matching.
    """
    detector = DetectorSettings(swap=0, merge=0, ghosts=0, person_miss=0)
    all_errors, all_scores = [], []
    for seed in range(3):
        settings = SceneSettings(people=1, seconds=80, cameras=5, radius_m=3.7, detector=detector)
        recording = simulate(settings, seed)
        assert recording.truth is not None
        joints = recording.truth.joints_m[:, 0]
        for camera, series in zip(recording.rig.cameras, recording.views, strict=True):
            counts = np.diff(series.starts)
            assert counts.max() <= 1
            keypoints = np.full((len(joints), 17, 2), np.nan)
            scores = np.zeros((len(joints), 17))
            keypoints[counts == 1], scores[counts == 1] = series.keypoints_px, series.scores
            distance = np.linalg.norm(joints[:, 11:13].mean(axis=1) - camera.center_m, axis=-1)
            scale = camera.K[0, 0] / distance
            at_shelf_scale = (scale > 240) & (scale < 430)
            error = np.where(
                at_shelf_scale[:, None, None], keypoints - camera.project(joints), np.nan
            )
            all_errors.append(error)
            all_scores.append(scores)
    return np.concatenate(all_errors, axis=1), np.concatenate(all_scores, axis=1)


@each_case(("score", "median_px", "gross_share"), MEASURED)
def test_residuals_of_a_score_have_the_measured_median_and_tail(
    score: float, median_px: float, gross_share: float
) -> None:
    errors, scores = noisy()
    size = np.linalg.norm(errors, axis=-1)
    size = size[(np.abs(scores - score) < 0.05) & np.isfinite(size)]
    assert len(size) > 200
    assert np.median(size) == pytest.approx(median_px, rel=0.15)
    assert (size > 40).mean() == pytest.approx(gross_share, rel=0.4, abs=0.003)


@each_case(("lag", "expected"), AUTOCORRELATION.items())
def test_residuals_remember_as_real_ones_do(lag: int, expected: float) -> None:
    errors, scores = noisy()
    typical = np.interp(scores, [m[0] for m in MEASURED], [m[1] for m in MEASURED])
    relative = np.clip(errors / typical[..., None], -3, 3)  # gross errors must not decide
    first, second = relative[:-lag], relative[lag:]
    both = np.isfinite(first) & np.isfinite(second)
    found = (first[both] * second[both]).mean() / np.sqrt(
        (first[both] ** 2).mean() * (second[both] ** 2).mean()
    )
    assert found == pytest.approx(expected, abs=0.07)


def test_memory_is_a_matter_of_seconds_not_of_frames() -> None:
    rng = np.random.default_rng(0)
    parts = ErrorMemory().parts
    slow, fast = correlated(rng, (4000, 300), 0.1, parts), correlated(rng, (8000, 300), 0.02, parts)
    assert slow.std() == pytest.approx(1, abs=0.03) and fast.std() == pytest.approx(1, abs=0.03)
    later = [(slow[:-1] * slow[1:]).mean(), (fast[:-5] * fast[5:]).mean()]
    expected = 0.45 * math.exp(-1) + 0.45 * math.exp(-0.1 / 2.5)
    assert later == pytest.approx([expected, expected], abs=0.02)


def test_views_err_independently() -> None:
    errors, _ = noisy()
    one, other = errors[:, :17], errors[:, 17:34]  # two cameras' sight of one person
    both = np.isfinite(one) & np.isfinite(other)
    clipped = np.clip(one[both], -30, 30), np.clip(other[both], -30, 30)
    assert abs(np.corrcoef(*clipped)[0, 1]) < 0.05


def test_normal_distribution_function_matches_the_error_function() -> None:
    x = np.linspace(-6, 6, 241)
    exact = [0.5 * math.erfc(-v / math.sqrt(2)) for v in x]
    assert normal_cdf(x) == pytest.approx(exact, abs=1e-7)


def test_noise_grows_with_people_only_outside_the_measured_sizes() -> None:
    assert size_scale(np.array([240.0, 300.0, 430.0])) == pytest.approx([1, 1, 1])
    assert size_scale(np.array([120.0, 860.0, 1.0])) == pytest.approx([0.5, 2.0, 0.2])


def test_scores_are_spread_like_a_real_detectors() -> None:
    _, scores = noisy()
    seen = scores[scores > 0]
    share = np.histogram(seen, bins=[0, 0.3, 0.5, 0.7, 0.9, 1.0])[0] / len(seen)
    # Shelf: .035 .065 .173 .628 .099
    assert share == pytest.approx([0.02, 0.05, 0.17, 0.62, 0.14], abs=0.05)
