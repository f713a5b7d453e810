"""What every predictor promises, and what the baselines, own weights and curves of errors do."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case
from tests.interpreted import interpreted

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.skeleton import COCO17
from e3pose.predict import PREDICTORS, make_predictor
from e3pose.predict.attention_lstm import SHIPPED, read_curves
from e3pose.predict.kernels.tracks import Curves, calibrated
from e3pose.predict.velocities import DampedVelocity, ZeroVelocity, newest_known

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
def test_people_do_not_affect_one_another_and_history_is_left_as_it_was(name: str) -> None:
    history = _walk(num_tracks=5)
    history[-3:, 1, 4] = np.nan
    before = history.copy()
    predictor = make_predictor(name)
    together = predictor.predict(history, 1 / 30, 6)
    alone = predictor.predict(history[:, 1:2], 1 / 30, 6)
    np.testing.assert_allclose(together.joints_m[:, 1:2], alone.joints_m, atol=1e-5)
    np.testing.assert_allclose(together.error_m[:, 1:2], alone.error_m, atol=1e-5)
    np.testing.assert_array_equal(history, before)


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
    assert np.isnan(prediction.joints_m[:, 0]).all() and np.isnan(prediction.error_m[:, 0]).all()
    assert np.isfinite(prediction.joints_m[:, 1]).all()


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


pytest.importorskip("onnxruntime", reason="onnxruntime is not installed: pip install e3pose[edge]")


def test_a_file_of_weights_predicts_as_it_does_when_shipped(tmp_path: Path) -> None:
    (tmp_path / "mine.onnx").write_bytes(SHIPPED.read_bytes())
    history = np.random.default_rng(0).normal(size=(10, 3, 17, 3))
    mine, shipped = (
        make_predictor(name, COCO17).predict(history, 0.04, 5).joints_m
        for name in (str(tmp_path / "mine.onnx"), "attention-lstm")
    )
    np.testing.assert_array_equal(mine, shipped)


def test_a_file_that_is_none_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.onnx: file not found"):
        make_predictor(str(tmp_path / "none.onnx"))
    no_text = SHIPPED.read_bytes().replace(b"num_leads", b"\xffum_leads")
    for name, content in (("damaged", b"damaged"), ("flipped", no_text)):
        (tmp_path / f"{name}.onnx").write_bytes(content)
        with pytest.raises(InputError, match=rf"{name}\.onnx: found no readable network"):
            make_predictor(str(tmp_path / f"{name}.onnx"))


def test_an_unknown_name_lists_what_there_is() -> None:
    with pytest.raises(InputError, match=r"found 'nobody', expected one of zero.*\.onnx"):
        make_predictor("nobody")


def errors(curves: Curves, lead: int, log_errors: list[float]) -> list[float]:
    stated = interpreted(calibrated)
    return [stated(np.float32(log_error), lead, curves) for log_error in log_errors]


def test_between_points_logarithms_are_linear_and_beyond_ratios_hold() -> None:
    curve = [[[-4.0, -3.0, -2.0], [-4.0, -3.0, -2.0]], [[-5.0, -3.0, -2.5], [-4.0, -3.0, -2.0]]]
    curves = read_curves({"error_factor": "[1.0]", "error_curve": json.dumps(curve)})
    given = [-6.0, -4.0, -3.5, -3.0, -2.5, -2.0, 0.0]
    bent = np.log([errors(curves, lead, given) for lead in range(2)])
    np.testing.assert_allclose(bent[0], [-7.0, -5.0, -4.0, -3.0, -2.75, -2.5, -0.5], atol=1e-6)
    np.testing.assert_allclose(bent[1], given, atol=1e-6)


def test_factors_alone_do_and_the_last_serves_later_leads() -> None:
    curves = read_curves({"error_factor": "[2.0, 3.0]"})
    found = [errors(curves, lead, [0.0])[0] for lead in range(4)]
    np.testing.assert_allclose(found, [2, 3, 3, 3])


@each_case(
    ("factor", "curve"),
    [
        ("[]", "null"),
        ("[0.0]", "null"),
        ("[NaN]", "null"),
        ('["a"]', "null"),
        ("null", "null"),
        ("{}", "null"),
        ("[1.0", "null"),
        ("[1.0]", "[1.0]"),
        ("[1.0]", "[[[0.0]], [[0.0]]]"),
        ("[1.0]", "[[[0.0, 0.0]], [[0.0, 1.0]]]"),
        ("[1.0]", "[[[0.0, 1.0]], [[1.0, 0.0]]]"),
        ("[1.0]", "[[[0.0, 1e9]], [[0.0, 1.0]]]"),
        ("[1.0]", "[" * 20_000),
    ],
)
def test_nonsense_is_refused(factor: str, curve: str) -> None:
    with pytest.raises(ValueError):
        read_curves({"error_factor": factor, "error_curve": curve})


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
