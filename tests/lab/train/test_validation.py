"""What held-out motion tells: other frame rates, and how honest expected errors are."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install e3pose[train]")

from e3pose.predict.normalise import NUM_COMMON
from e3pose_lab.train.validation import Marks, error_curves, make_exams, resampled
from e3pose_lab.train.windows import Clip


def test_another_frame_rate_is_the_same_motion() -> None:
    time = np.arange(120)[:, None, None] / 30 + np.zeros((1, NUM_COMMON, 3))
    joints = np.sin(3 * time).astype(np.float32)
    for fps in (15.0, 60.0):
        other = resampled(joints, 30 / fps)
        expected = np.sin(3 * np.arange(len(other)) / fps)
        np.testing.assert_allclose(other[:, 5, 1], expected, atol=1e-4)


def test_known_motion_is_examined_at_other_rates_where_it_is_long_enough() -> None:
    clip = Clip("swing", np.zeros((200, NUM_COMMON, 3), np.float32), 30.0)
    names = [exam.name for exam in make_exams([("swing", [clip])], 10, 15)]
    rates = ["swing", "swing at 5 slots per second", "swing at 15 slots per second"]
    rates.append("swing at 60 slots per second")
    assert names == [f"{rate}, {kind}" for rate in rates for kind in ("exact", "noisy")]
    short = Clip("swing", np.zeros((30, NUM_COMMON, 3), np.float32), 30.0)
    assert len(make_exams([("swing", [short])], 10, 15)) == 4
    estimated = Clip(
        "e", clip.joints_m, 30.0, errors_m=np.zeros((200, 1, NUM_COMMON, 3), np.float16)
    )
    assert len(make_exams([("e", [estimated])], 10, 15)) == 1


def test_curves_make_expected_errors_right_at_every_size() -> None:
    rng = np.random.default_rng(0)
    expected = np.exp(rng.uniform(-5, -2, (2, 20_000)))
    wrong = np.stack([expected[0] ** 1.5 * 3, expected[1] * 0.5])
    actual = wrong * rng.exponential(1, wrong.shape)
    marks = Marks("m", np.zeros(2), np.zeros(2), np.zeros((3, 2)), np.stack([expected, actual]))
    curves = error_curves([marks])
    assert curves.shape == (2, 2, 8) and (np.diff(curves) >= 0).all()
    np.testing.assert_allclose(curves[1, 0], np.log(3) + 1.5 * curves[0, 0], atol=0.1)
    np.testing.assert_allclose(curves[1, 1], np.log(0.5) + curves[0, 1], atol=0.1)
