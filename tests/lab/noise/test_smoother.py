"""The offline smoother against paths that are known."""

from __future__ import annotations

import numpy as np
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.estimate.filter.bones import proportions_of
from e3pose.estimate.filter.tree import grow
from e3pose.model.projection import project
from e3pose.simulate import DetectorSettings, SceneSettings, simulate
from e3pose_lab.noise.smoother import smooth

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


def test_exact_keypoints_give_the_path() -> None:
    assert mean_mm(smooth(KEYPOINTS, SIGMA * 0.1, P, roughly(), INTERVAL_S)) < 0.5


def test_pixels_are_those_of_the_cameras() -> None:
    pixels, depth, jacobian = project(PATH, P)
    np.testing.assert_allclose(pixels.swapaxes(0, 1), KEYPOINTS, atol=1e-6)
    assert (depth > 0).all()
    step = np.array([1e-6, -2e-6, 3e-6])
    moved = project(PATH + step, P)[0] - pixels
    np.testing.assert_allclose(jacobian @ step, moved, atol=1e-6)


def test_time_and_views_average_noise() -> None:
    # 4 px at about 330 px a metre is 12 mm in either axis of one view, 17 mm in the plane.
    assert mean_mm(smooth(noisy(), SIGMA, P, roughly(), INTERVAL_S)) < 9


def test_wild_keypoints_are_resisted() -> None:
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


def test_a_joint_that_nobody_sees_stays_finite() -> None:
    unseen = KEYPOINTS.copy()
    unseen[:, :, 5] = np.nan
    assert np.isfinite(smooth(unseen, SIGMA, P, roughly(), INTERVAL_S)).all()


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
