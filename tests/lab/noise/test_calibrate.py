"""Noise of detectors: measured on recordings by an offline smoother."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.estimate.filter.bones import proportions_of
from e3pose.estimate.filter.tree import grow
from e3pose.model.noise import ErrorMemory
from e3pose.model.pose import Poses2D
from e3pose.recording import Recording, ViewSeries
from e3pose.simulate import DetectorSettings, SceneSettings, simulate
from e3pose.simulate.noise import correlated, normal_cdf
from e3pose_lab.noise.calibrate import calibrate_noise
from e3pose_lab.noise.residuals import Residuals
from e3pose_lab.noise.smoother import smooth
from e3pose_lab.noise.statistics import RAYLEIGH, autocorrelation, describe, falling, fit_memory

pytestmark = pytest.mark.slow


KNOTS, SIGMA_PX = np.array([0.1, 0.4, 0.7, 1.0]), np.array([14.0, 9.0, 5.0, 2.5])


@functools.cache
def known_noise(cameras: int = 5, seconds: float = 6.0, seed: int = 1) -> Recording:
    """Return people of whom each keypoint has a random score, and the error of that score.

    The errors last as those of real detectors do.
    """
    detector = DetectorSettings(perfect=True)
    settings = SceneSettings(people=3, seconds=seconds, cameras=cameras, detector=detector)
    recording = simulate(settings, seed=seed)
    assert recording.truth is not None
    truth_m, interval_s = recording.truth.joints_m, recording.interval_s
    rng = np.random.default_rng(seed)
    views = []
    for camera in recording.rig.cameras:
        pixels, inside = camera.project(truth_m), camera.sees(truth_m)
        scores = normal_cdf(correlated(rng, inside.shape, interval_s, ((0.3, 0.1), (0.7, 1.0))))
        scores = 0.12 + 0.86 * scores
        errors = correlated(rng, pixels.shape, interval_s, ErrorMemory().parts)
        pixels = pixels + errors * np.interp(scores, KNOTS, SIGMA_PX)[..., None]
        pixels = np.where(inside[..., None], pixels, np.nan)
        scores = np.where(inside, scores, 0.0)
        views.append(
            ViewSeries.from_views(
                [Poses2D(k[s.any(1)], s[s.any(1)]) for k, s in zip(pixels, scores, strict=True)],
                range(len(truth_m)),
                (np.arange(len(truth_m)) * interval_s).tolist(),
                17,
            )
        )
    return replace(recording, truth=None, views=tuple(views))


@pytest.mark.parametrize(
    ("cameras", "tolerance"), [(5, 0.12), pytest.param(3, 0.25, marks=pytest.mark.nightly)]
)
def test_known_noise_is_recovered(cameras: int, tolerance: float) -> None:
    calibrated = calibrate_noise(known_noise(cameras))
    assert calibrated.people == 3
    true = np.interp(calibrated.noise.scores, KNOTS, SIGMA_PX)
    off = calibrated.noise.sigma_px / true - 1
    assert np.abs(off).max() < tolerance
    assert np.abs(off).mean() < tolerance / 2
    # Without the correction, small errors drown in those of the reference.
    assert calibrated.measured.sigma_px[-1] > 1.3 * true[-1]
    memory, usual = calibrated.noise.memory, ErrorMemory()
    assert memory.lasting_share == pytest.approx(usual.lasting_share, abs=0.1)
    assert memory.quick_share == pytest.approx(usual.quick_share, abs=0.1)
    # Nor do residuals show what is new in every slot: the reference follows it.
    assert memory.new_share > fit_memory(calibrated.measured.autocorrelation).new_share


def test_seconds_cut_a_recording_of_which_a_part_is_scored() -> None:
    recording = replace(known_noise(), scored_slots=(60, 140))
    assert calibrate_noise(recording, seconds=2.0).slots == 50


@pytest.mark.nightly
def test_a_shifted_camera_is_named_and_can_be_taken_out() -> None:
    recording = known_noise(4, 8.0)
    shift = np.array([30.0, 10.0])
    views = list(recording.views)
    views[1] = replace(views[1], keypoints_px=views[1].keypoints_px + shift)
    calibrated = calibrate_noise(replace(recording, views=tuple(views)), without_shifts=True)
    found = calibrated.shifts_px + [v.shift_px for v in calibrated.measured.views.values()]
    assert np.linalg.norm(found[1] - shift) < 10
    assert np.linalg.norm(np.delete(found, 1, axis=0), axis=-1).max() < 8
    true = np.interp(calibrated.noise.scores, KNOTS, SIGMA_PX)
    assert calibrated.noise.sigma_px / true == pytest.approx(np.ones(len(true)), abs=0.3)


def test_exact_detections_have_hardly_any_noise() -> None:
    detector = DetectorSettings(perfect=True)
    recording = simulate(SceneSettings(people=2, seconds=2.0, detector=detector), seed=2)
    assert calibrate_noise(recording).noise.sigma_px.max() < 1.5


def test_truth_is_not_looked_at() -> None:
    recording = simulate(SceneSettings(people=2, seconds=1.5), seed=2)
    assert recording.truth is not None
    wrong = replace(recording.truth, joints_m=recording.truth.joints_m + 5)
    lied_to = calibrate_noise(replace(recording, truth=wrong))
    np.testing.assert_array_equal(lied_to.noise.sigma_px, calibrate_noise(recording).noise.sigma_px)


@each_case(
    ("people", "cameras", "words"),
    [
        (1, 2, "found 2 cameras, expected at least 3"),
        (0, 4, "found 0 keypoints that two other views confirm"),
    ],
)
def test_where_nothing_can_be_measured_it_is_said(people: int, cameras: int, words: str) -> None:
    with pytest.raises(InputError, match=words):
        calibrate_noise(simulate(SceneSettings(people=people, seconds=1.0, cameras=cameras), 0))


def test_falling_is_the_nearest_that_never_rises() -> None:
    np.testing.assert_allclose(falling(np.array([5.0, 3, 4, 1]), np.ones(4)), [5, 3.5, 3.5, 1])
    np.testing.assert_allclose(falling(np.array([1.0, 4]), np.array([3, 1])), [1.75, 1.75])
    values = np.random.default_rng(0).normal(size=50)
    assert (np.diff(falling(values, np.ones(50))) <= 1e-12).all()


def residuals(errors_px: Floats, scores: Floats) -> Residuals:
    """Return residuals `(num_slots, num_series, 2)` of as many joints of one camera."""
    slots, series = np.indices(scores.shape).reshape(2, -1)
    return Residuals(
        errors_px.reshape(-1, 2), scores.ravel(), np.zeros(scores.size, dtype=int), series, slots
    )


def test_sigma_is_robust_and_gross_errors_are_counted() -> None:
    rng = np.random.default_rng(0)
    scores = rng.uniform(0.1, 1.0, (400, 50))
    errors = rng.normal(scale=5.0, size=(400, 50, 2))
    gross = rng.random((400, 50)) < 0.1
    errors[gross] += 300
    found = describe(residuals(errors, scores), 0.04, 1032)
    assert found.gross_share == pytest.approx(np.full(9, 0.1), abs=0.02)
    assert found.sigma_px == pytest.approx(np.full(9, 5.0), rel=0.1)  # a tenth gone: 8 % more
    assert found.counts.sum() == 20_000
    assert (np.diff(found.scores) > 0).all()
    assert pytest.approx(1.1774, abs=1e-4) == RAYLEIGH


def test_bias_is_the_mean_of_a_joint() -> None:
    rng = np.random.default_rng(0)
    biases = np.array([[3.0, 4], [-3, 4], [3, -4], [-3, -4]])
    errors = biases + rng.normal(scale=1.0, size=(500, 4, 2))
    view = describe(residuals(errors, np.full((500, 4), 0.5)), 0.04, 1032).views[0]
    assert view.bias_px == pytest.approx(5, rel=0.03)
    assert np.linalg.norm(view.shift_px) < 3  # to all sides, which is no shift of the camera


def test_memory_of_known_noise_is_found() -> None:
    rng = np.random.default_rng(0)
    memory = ErrorMemory(lasting_share=0.2, quick_share=0.3)
    errors = correlated(rng, (2000, 60, 2), 0.04, memory.parts)
    what = residuals(errors, np.full((2000, 60), 0.5))
    found = autocorrelation(what, np.ones(len(what)), 0.04)
    for lag_s, value in found.items():
        expected = 0.3 * np.exp(-lag_s / 0.1) + 0.2 * np.exp(-lag_s / 2.5)
        assert value == pytest.approx(expected, abs=0.04)
    fitted = fit_memory(found)
    assert fitted.lasting_share == pytest.approx(0.2, abs=0.06)
    assert fitted.quick_share == pytest.approx(0.3, abs=0.06)


RECORDING = simulate(
    SceneSettings(people=1, seconds=4, cameras=4, detector=DetectorSettings(perfect=True)), seed=3
)
TRUTH = RECORDING.truth
assert TRUTH is not None
PATH: Floats = TRUTH.joints_m[:, 0]
P = RECORDING.rig.projections
INTERVAL_S = RECORDING.interval_s
KEYPOINTS = np.stack([camera.project(PATH) for camera in RECORDING.rig.cameras], axis=1)
SIGMA = np.full(KEYPOINTS.shape[:-1], 4.0)


def roughly(seed: int = 0) -> Floats:
    return PATH + np.random.default_rng(seed).normal(scale=0.05, size=PATH.shape)


def mean_mm(path: Floats) -> float:
    return 1000 * float(np.linalg.norm(path - PATH, axis=-1).mean())


def noisy(seed: int = 1) -> Floats:
    return KEYPOINTS + np.random.default_rng(seed).normal(scale=4.0, size=KEYPOINTS.shape)


def test_time_and_views_average_noise_and_resist_wild_keypoints() -> None:
    assert mean_mm(smooth(KEYPOINTS, SIGMA * 0.1, P, roughly(), INTERVAL_S)) < 0.5, "exact ones"
    # 4 px at about 330 px a metre is 12 mm in either axis of one view, 17 mm in the plane.
    assert mean_mm(smooth(noisy(), SIGMA, P, roughly(), INTERVAL_S)) < 9
    wild = noisy()
    wild[::6, 1] += 150
    assert mean_mm(smooth(wild, SIGMA, P, roughly(), INTERVAL_S)) < 10


def test_a_view_left_out_says_nothing() -> None:
    sigma = SIGMA.copy()
    sigma[:, 2] = np.inf
    spoilt = noisy()
    spoilt[:, 2] = 1e4
    gone = noisy()
    gone[:, 2] = np.nan
    with_spoilt = smooth(spoilt, sigma, P, roughly(), INTERVAL_S)
    np.testing.assert_allclose(with_spoilt, smooth(gone, sigma, P, roughly(), INTERVAL_S))
    rest = [0, 1, 3]
    alone = smooth(noisy()[:, rest], SIGMA[:, rest], P[rest], roughly(), INTERVAL_S)
    np.testing.assert_allclose(with_spoilt, alone, atol=1e-9)


def test_a_gap_is_crossed() -> None:
    gappy = KEYPOINTS.copy()
    gappy[40:45] = np.nan  # a fifth of a second
    path = smooth(gappy, SIGMA, P, roughly(), INTERVAL_S)
    assert 1000 * np.linalg.norm(path[40:45] - PATH[40:45], axis=-1).mean() < 15
    gappy[:, :, 5] = np.nan  # a joint that nobody sees stays finite
    assert np.isfinite(smooth(gappy, SIGMA, P, roughly(), INTERVAL_S)).all()


@each_case("slots", [1, 2, 3])
def test_few_slots_are_enough(slots: int) -> None:
    path = smooth(KEYPOINTS[:slots], SIGMA[:slots], P, PATH[:slots] + 0.03, INTERVAL_S)
    assert 1000 * np.linalg.norm(path - PATH[:slots], axis=-1).max() < 1


def test_guessed_ankles_are_held_to_the_length_of_the_shank() -> None:
    skeleton = RECORDING.skeleton
    knee, ankle = skeleton.index("left_knee"), skeleton.index("left_ankle")
    seen = noisy()
    rng = np.random.default_rng(2)
    seen[:, :, ankle] += rng.normal(scale=50, size=(1, seen.shape[1], 2))  # a guess of every camera
    body = proportions_of(skeleton, grow(skeleton))
    loose = smooth(seen, SIGMA, P, roughly(), INTERVAL_S)
    held = smooth(seen, SIGMA, P, roughly(), INTERVAL_S, rigid=body)
    true_m = np.linalg.norm(PATH[:, knee] - PATH[:, ankle], axis=-1)
    off = [
        np.abs(np.linalg.norm(path[:, knee] - path[:, ankle], axis=-1) / true_m - 1)
        for path in (loose, held)
    ]
    assert off[0].max() > 0.3 and off[1].max() < 0.1
    others = np.setdiff1d(np.arange(len(skeleton)), [ankle])
    assert 1000 * np.linalg.norm(held - PATH, axis=-1)[:, others].mean() < 10
