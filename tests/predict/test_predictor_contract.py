"""What every predictor promises, over every entry of PREDICTORS."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.predict import PREDICTORS, make_predictor

NAMES = sorted(PREDICTORS)


@each_case("name", NAMES)
@each_case("num_tracks", [0, 1, 4])
@each_case("lead_slots", [1, 5])
def test_shape_is_lead_by_history(name: str, num_tracks: int, lead_slots: int) -> None:
    history = np.random.default_rng(0).normal(size=(10, num_tracks, 17, 3))
    prediction = make_predictor(name).predict(history, 0.04, lead_slots)
    assert prediction.joints_m.shape == (lead_slots, num_tracks, 17, 3)
    assert prediction.error_m.shape == (lead_slots, num_tracks, 17)
    assert np.isfinite(prediction.joints_m).all()


@each_case("name", NAMES)
def test_somebody_standing_still_stays_where_they_are(name: str) -> None:
    pose = np.random.default_rng(1).normal(scale=0.3, size=(2, 17, 3))  # as large as people
    predicted = make_predictor(name).predict(np.repeat(pose[None], 10, axis=0), 0.04, 10).joints_m
    np.testing.assert_allclose(predicted, np.repeat(pose[None], 10, axis=0), atol=0.02)


@each_case("name", NAMES)
def test_only_joints_never_seen_are_missing(name: str) -> None:
    history = np.random.default_rng(2).normal(size=(10, 2, 17, 3))
    history[:, 0, 3] = np.nan  # never seen
    history[-4:, 1, 5] = np.nan  # lost lately
    history[:9, 1, 6] = np.nan  # just appeared
    predicted = make_predictor(name).predict(history, 0.04, 3).joints_m
    missing = np.zeros((2, 17), dtype=bool)
    missing[0, 3] = True
    np.testing.assert_array_equal(np.isnan(predicted).any(axis=(0, 3)), missing)


@each_case("name", NAMES)
def test_people_do_not_affect_one_another(name: str) -> None:
    history = _walk(num_tracks=5)
    history[-3:, 1, 4] = np.nan
    predictor = make_predictor(name)
    together = predictor.predict(history, 1 / 30, 6)
    alone = predictor.predict(history[:, 1:2], 1 / 30, 6)
    np.testing.assert_allclose(together.joints_m[:, 1:2], alone.joints_m, atol=1e-5)
    np.testing.assert_allclose(together.error_m[:, 1:2], alone.error_m, atol=1e-5)


@each_case("name", NAMES)
def test_place_in_the_room_does_not_matter(name: str) -> None:
    history = _walk(num_tracks=2)
    predictor = make_predictor(name)
    here = predictor.predict(history, 1 / 30, 6).joints_m
    there = predictor.predict(history + [40.0, -25.0, 0.0], 1 / 30, 6).joints_m
    np.testing.assert_allclose(there - [40.0, -25.0, 0.0], here, atol=1e-4)


@each_case("name", NAMES)
def test_a_longer_look_ahead_begins_like_a_shorter_one(name: str) -> None:
    predictor = make_predictor(name)
    far = predictor.predict(_walk(num_tracks=2), 1 / 30, 15)
    near = predictor.predict(_walk(num_tracks=2), 1 / 30, 4)
    np.testing.assert_allclose(far.joints_m[:4], near.joints_m, atol=1e-5)


@each_case("name", NAMES)
def test_one_slot_of_history_is_enough(name: str) -> None:
    history = _walk(num_tracks=2)[-1:]
    predicted = make_predictor(name).predict(history, 1 / 30, 5).joints_m
    assert np.isfinite(predicted).all()
    assert np.abs(predicted - history).max() < 0.5


@each_case("name", NAMES)
def test_somebody_never_seen_stays_unknown(name: str) -> None:
    history = _walk(num_tracks=2)
    history[:, 0] = np.nan
    prediction = make_predictor(name).predict(history, 1 / 30, 5)
    assert np.isnan(prediction.joints_m[:, 0]).all()
    assert np.isfinite(prediction.joints_m[:, 1]).all()


@each_case("name", NAMES)
def test_history_is_left_as_it_was(name: str) -> None:
    history = _walk(num_tracks=2)
    history[3, 0, 2] = np.nan
    before = history.copy()
    make_predictor(name).predict(history, 1 / 30, 5)
    np.testing.assert_array_equal(history, before)


def _walk(num_tracks: int) -> Floats:
    """Bodies of a person's size that walk at 1.2 m/s, 10 slots of 1/30 s."""
    rng = np.random.default_rng(5)
    bodies = rng.normal(scale=[0.2, 0.2, 0.4], size=(num_tracks, 17, 3)) + [0, 0, 1]
    steps = np.arange(10)[:, None, None, None] * np.array([0.04, 0.0, 0.0])
    return np.asarray(bodies + steps)


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
