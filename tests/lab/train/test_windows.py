"""Training windows: what they are cut from, and how an estimator's errors are imitated."""

from __future__ import annotations

import numpy as np
import pytest
from tests.reference.normalise import to_world

from e3pose.predict.normalise import NUM_COMMON
from e3pose_lab.train.windows import (
    Clip,
    Corruption,
    Sampler,
    estimation_noise,
    spoil,
    usual_error,
)

CLEAN = Corruption(exact=1.0, missing=0.0, short=0.0)


def gliding_clip(num_slots: int = 60, speed: float = 0.02, fps: float = 30.0) -> Clip:
    pose = np.random.default_rng(0).normal(size=(NUM_COMMON, 3)) * 0.3
    path = np.arange(num_slots)[:, None, None] * np.array([speed, 0, 0])
    return Clip("gliding", (pose + path).astype(np.float32), fps)


def test_windows_of_even_motion_go_on_evenly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("e3pose_lab.train.windows.UNEVEN", 0.0)
    sampler = Sampler([gliding_clip()], 10, 15)
    windows = sampler.draw(np.random.default_rng(0), 200, CLEAN)
    assert windows.normal.features.shape == (10, 200, 7 * NUM_COMMON)
    assert windows.future_m.shape == (15, 200, NUM_COMMON, 3)
    world = to_world(windows.normal, windows.future_m)
    steps = np.diff(np.concatenate([windows.normal.newest_m[None], world]), axis=0)
    np.testing.assert_allclose(steps, np.broadcast_to(steps[:1], steps.shape), atol=1e-5)
    np.testing.assert_allclose(windows.usual_m, 0, atol=1e-4)  # constant velocity is right


def test_windows_never_leave_their_clip() -> None:
    far = gliding_clip()
    sampler = Sampler([gliding_clip(), Clip("far", far.joints_m + 1000, 30.0)], 10, 15)
    windows = sampler.draw(np.random.default_rng(1), 500, CLEAN)
    assert np.abs(windows.future_m).max() < 5


def test_short_clips_are_drawn_at_a_rate_that_fits() -> None:
    windows = Sampler([gliding_clip(26)], 10, 15).draw(np.random.default_rng(2), 100, CLEAN)
    assert np.isfinite(windows.future_m).all()


def test_the_same_seed_draws_the_same() -> None:
    sampler = Sampler([gliding_clip()], 10, 15)
    first, second = (sampler.draw(np.random.default_rng(3), 20, Corruption()) for _ in range(2))
    np.testing.assert_array_equal(first.normal.features, second.normal.features)
    np.testing.assert_array_equal(first.future_m, second.future_m)


def test_noise_has_the_size_and_memory_asked_for() -> None:
    size = 4000
    level, interval = np.full(size, 0.03), np.full(size, 1 / 25)
    noise = estimation_noise(21, level, interval, np.random.default_rng(4))
    assert np.sqrt(np.square(noise).sum(axis=-1).mean()) == pytest.approx(0.03, rel=0.15)
    power = np.square(noise[0]).mean()
    kept = [float((noise[0] * noise[k]).mean() / power) for k in (1, 8, 20)]
    # Measured on detections: 0.77, 0.41 and 0.30; shares vary from window to window here.
    np.testing.assert_allclose(kept, [0.74, 0.40, 0.32], atol=0.08)


def test_no_noise_is_exact() -> None:
    history = np.random.default_rng(5).normal(size=(10, 7, NUM_COMMON, 3))
    spoilt = spoil(history, np.full(7, 0.04), np.random.default_rng(6), CLEAN)
    np.testing.assert_array_equal(spoilt, history)


def test_every_window_keeps_something() -> None:
    history = np.zeros((10, 3000, NUM_COMMON, 3))
    worst = Corruption(exact=0.0, missing=1.0, short=1.0)
    spoilt = spoil(history, np.full(3000, 0.04), np.random.default_rng(7), worst)
    assert np.isfinite(spoilt).any(axis=(0, 2, 3)).all()
    share = np.isnan(spoilt[-1]).mean()
    assert 0.1 < share < 0.5


def test_usual_error_is_that_of_the_best_simple_predictor() -> None:
    slot = np.arange(13)[:, None, None, None]
    still = np.zeros((13, 1, NUM_COMMON, 3))
    moving = still + slot * [0.1, 0, 0]
    jumps = still.copy()
    jumps[10:, ..., 0] = 0.5
    joints = np.concatenate([still, moving, jumps], axis=1)
    error = usual_error(joints[:10], joints[10:])
    np.testing.assert_allclose(error, [[0, 0, 0.5]] * 3, atol=1e-12)
