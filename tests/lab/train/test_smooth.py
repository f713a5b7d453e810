"""Smoothing: keeps what moves, takes away what trembles, closes short gaps only."""

from __future__ import annotations

import numpy as np
import pytest

from e3pose.base.arrays import Floats
from e3pose_lab.train.smooth import smooth

DT = 1 / 25


def parabola(slots: int = 40) -> Floats:
    t = np.arange(slots)[:, None, None] * DT
    return np.asarray(
        np.array([1.0, -2.0, 0.5]) * t**2 + np.array([0.3, 0, 1]) * t + np.ones((1, 2, 3))
    )


def test_a_parabola_stays_as_it_is() -> None:
    np.testing.assert_allclose(smooth(parabola(), DT), parabola(), atol=1e-9)


def test_noise_becomes_less() -> None:
    noise = np.random.default_rng(0).normal(0, 0.02, (400, 5, 3))
    left = smooth(noise, DT)[5:-5]
    assert left.std() < 0.75 * 0.02


@pytest.mark.parametrize(("hertz", "least"), [(1.0, 0.99), (2.0, 0.97), (4.0, 0.7)])
def test_human_motion_passes(hertz: float, least: float) -> None:
    t = np.arange(200)[:, None, None] * DT
    wave = 0.05 * np.sin(2 * np.pi * hertz * t) * np.ones((1, 1, 3))
    kept = smooth(wave, DT)[20:-20]
    assert kept.std() / wave[20:-20].std() > least


def test_an_outlier_counts_less() -> None:
    joints = parabola()
    joints[20, 0] += 0.5
    off = np.abs(smooth(joints, DT) - parabola())
    assert off.max() < 0.25 * 0.5
    np.testing.assert_allclose(off[:, 1], 0, atol=1e-9)


def test_short_gaps_are_closed_and_long_ones_stay() -> None:
    joints = parabola()
    joints[10:12, 0] = np.nan
    joints[20:35, 1] = np.nan
    result = smooth(joints, DT)
    np.testing.assert_allclose(result[:, 0], parabola()[:, 0], atol=1e-9)
    assert np.isnan(result[22:33, 1]).all()
    assert np.isnan(smooth(joints[11:12], DT)[:, 0]).all()


def test_nothing_is_made_up_before_and_after() -> None:
    joints = parabola()
    joints[:5] = joints[-5:] = np.nan
    result = smooth(joints, DT)
    assert np.isnan(result[:5]).all() and np.isnan(result[-5:]).all()


def test_few_slots_a_second_are_left_alone() -> None:
    joints = np.random.default_rng(0).normal(size=(10, 3, 3))
    lacking = joints.copy()
    lacking[4, 0] = lacking[7:, 1] = np.nan
    wanted = lacking.copy()
    wanted[4, 0] = (joints[3, 0] + joints[5, 0]) / 2
    np.testing.assert_array_equal(smooth(lacking, 0.2), wanted)
