"""The baselines against motion of known velocity."""

from __future__ import annotations

import numpy as np
import pytest

from e3pose.base.arrays import Floats
from e3pose.predict.velocities import DampedVelocity, ZeroVelocity, newest_known


def _uniform(num_slots: int, step_m: float) -> Floats:
    """One person of three joints moving along x, at 0 in the newest slot."""
    history = np.zeros((num_slots, 1, 3, 3))
    history[..., 0] = (np.arange(num_slots) - num_slots + 1)[:, None, None] * step_m
    return history


def test_newest_known_skips_unknown_slots() -> None:
    history = _uniform(4, 1.0)
    history[2:, 0, 1] = np.nan
    history[:, 0, 2] = np.nan
    position, age = newest_known(history)
    np.testing.assert_array_equal(position[0, :2, 0], [0.0, -2.0])
    assert np.isnan(position[0, 2]).all()
    np.testing.assert_array_equal(age[0], [0, 2, 0])


def test_zero_velocity_repeats_the_newest_known_position() -> None:
    history = _uniform(5, 0.1)
    history[-1, 0, 2] = np.nan
    predicted = ZeroVelocity().predict(history, 1 / 30, 3).joints_m
    np.testing.assert_allclose(predicted[:, 0, :, 0], [[0.0, 0.0, -0.1]] * 3)


@pytest.mark.parametrize("fps", [30.0, 29.97])
def test_damped_velocity_decays_by_085_a_frame_at_30_fps(fps: float) -> None:
    predicted = DampedVelocity().predict(_uniform(10, 0.1), 1 / fps, 3).joints_m
    expected = 0.1 * np.cumsum([0.85, 0.85**2, 0.85**3])
    np.testing.assert_allclose(predicted[:, 0, 0, 0], expected, rtol=2e-3)


def test_damped_velocity_averages_over_three_frames() -> None:
    history = _uniform(10, 0.0)
    history[-4, ..., 1] = -0.3  # the last slot that counts: 0.3 m in three frames
    history[-5, ..., 1] = 9.0
    predicted = DampedVelocity().predict(history, 1 / 30, 1).joints_m
    np.testing.assert_allclose(predicted[0, 0, 0, 1], 0.85 * 0.1)


def test_damped_velocity_decays_alike_in_time_at_any_rate() -> None:
    """One metre per second ends 0.85/0.15 frames of 1/30 s further on, at any rate about there."""
    for fps in (15, 60, 120):
        predicted = DampedVelocity().predict(_uniform(60, 1 / fps), 1 / fps, 20 * fps).joints_m
        assert predicted[-1, 0, 0, 0] == pytest.approx(1 / 30 * 0.85 / 0.15, abs=0.035)
        half = round(0.5 * fps)
        left = 1 - predicted[half - 1, 0, 0, 0] / predicted[-1, 0, 0, 0]
        assert left == pytest.approx(0.85 ** (30 * half / fps), rel=1e-6)


def test_damped_velocity_moves_a_lost_joint_with_its_person() -> None:
    history = _uniform(10, 0.1)
    history[-6:, 0, 2] = np.nan  # seen last six slots ago, at x = -0.6
    predicted = DampedVelocity().predict(history, 1 / 30, 1).joints_m
    expected = -0.6 + 0.1 * sum(0.85**k for k in range(1, 8))
    np.testing.assert_allclose(predicted[0, 0, 2, 0], expected)


def test_damped_velocity_bridges_a_gap() -> None:
    history = _uniform(10, 0.1)
    history[-3:-1, 0, 0] = np.nan  # still known at both ends of the span
    predicted = DampedVelocity().predict(history, 1 / 30, 1).joints_m
    np.testing.assert_allclose(predicted[0, 0, 0, 0], 0.085)
