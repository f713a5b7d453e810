"""What every predictor promises, over every entry of PREDICTORS."""

from __future__ import annotations

import numpy as np
import pytest

from e3pose.errors import InputError
from e3pose.predictors import PREDICTORS, make_predictor

NAMES = sorted(PREDICTORS)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("num_tracks", [0, 1, 4])
@pytest.mark.parametrize("lead_slots", [1, 5])
def test_shape_is_lead_by_history(name: str, num_tracks: int, lead_slots: int) -> None:
    history = np.random.default_rng(0).normal(size=(10, num_tracks, 17, 3))
    prediction = make_predictor(name).predict(history, 0.04, lead_slots)
    assert prediction.joints_m.shape == (lead_slots, num_tracks, 17, 3)
    assert prediction.error_m.shape == (lead_slots, num_tracks, 17)
    assert np.isfinite(prediction.joints_m).all()


@pytest.mark.parametrize("name", NAMES)
def test_somebody_standing_still_stays_where_they_are(name: str) -> None:
    pose = np.random.default_rng(1).normal(size=(2, 17, 3))
    predicted = make_predictor(name).predict(np.repeat(pose[None], 10, axis=0), 0.04, 10).joints_m
    np.testing.assert_allclose(predicted, np.repeat(pose[None], 10, axis=0), atol=0.02)


@pytest.mark.parametrize("name", NAMES)
def test_only_joints_never_seen_are_missing(name: str) -> None:
    history = np.random.default_rng(2).normal(size=(10, 2, 17, 3))
    history[:, 0, 3] = np.nan  # never seen
    history[-4:, 1, 5] = np.nan  # lost lately
    history[:9, 1, 6] = np.nan  # just appeared
    predicted = make_predictor(name).predict(history, 0.04, 3).joints_m
    missing = np.zeros((2, 17), dtype=bool)
    missing[0, 3] = True
    np.testing.assert_array_equal(np.isnan(predicted).any(axis=(0, 3)), missing)


def test_constant_velocity_carries_the_newest_motion_on() -> None:
    start = np.random.default_rng(3).normal(size=(2, 17, 3))
    velocity = np.random.default_rng(4).normal(scale=0.02, size=(2, 17, 3))
    history = start + np.arange(10)[:, None, None, None] * velocity
    history[0] += 5.0  # only the two newest slots count
    predicted = make_predictor("constant-velocity").predict(history, 0.04, 4).joints_m
    expected = start + np.arange(10, 14)[:, None, None, None] * velocity
    np.testing.assert_allclose(predicted, expected, atol=1e-9)


def test_constant_velocity_moves_a_lost_joint_with_its_person() -> None:
    history = np.zeros((4, 1, 3, 3))
    history[:, 0] += np.arange(4)[:, None, None] * [0.1, 0.0, 0.0]
    history[-2:, 0, 2] = np.nan  # last seen at x = 0.1, two slots ago
    predicted = make_predictor("constant-velocity").predict(history, 0.04, 1).joints_m
    np.testing.assert_allclose(predicted[0, 0, :, 0], [0.4, 0.4, 0.4])


def test_unknown_predictor_names_the_known_ones() -> None:
    with pytest.raises(InputError, match="constant-velocity"):
        make_predictor("crystal-ball")
