"""The attention-LSTM predictor at run time: rules for what is missing, damaged or too much."""

from __future__ import annotations

import logging
import re
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.skeleton import BODY25, BODY_JOINTS, CMU31, COCO17, SKELETONS, Skeleton, convert
from e3pose.predict import Prediction, make_predictor, make_predictor_or_fallback
from e3pose.predict.attention_lstm import MAX_LEADS, SHIPPED, AttentionLstm
from e3pose.predict.velocities import ConstantVelocity

pytestmark = pytest.mark.slow


pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")

# A standing person in COCO-17, metres, facing +y.
STANDING = np.array(
    [
        [0, 0.1, 1.62], [-0.03, 0.08, 1.65], [0.03, 0.08, 1.65], [-0.07, 0, 1.63], [0.07, 0, 1.63],
        [-0.18, 0, 1.42], [0.18, 0, 1.42], [-0.22, 0, 1.12], [0.22, 0, 1.12], [-0.22, 0.06, 0.88],
        [0.22, 0.06, 0.88], [-0.1, 0, 0.92], [0.1, 0, 0.92], [-0.1, 0.02, 0.5], [0.1, 0.02, 0.5],
        [-0.1, 0, 0.08], [0.1, 0, 0.08],
    ]
)  # fmt: skip


def gliding(num_slots: int = 10, speed_m: float = 0.04, seed: int = 0) -> Floats:
    """Three people, `(num_slots, 3, 17, 3)`: one still, one gliding, one gliding and waving."""
    slot = np.arange(num_slots)[:, None, None]
    people = np.stack([STANDING + [2.0 * k, 0, 0] for k in range(3)])
    history = np.repeat(people[None], num_slots, axis=0)
    history[:, 1] += slot * [0, speed_m, 0]
    history[:, 2] += slot * [speed_m, 0, 0]
    history[:, 2, 9] += np.sin(0.3 * slot[:, 0]) * [0, 0, 0.2]
    return history


def predict(history: Floats, lead: int = 10, skeleton: Skeleton = COCO17) -> Prediction:
    return make_predictor("attention-lstm", skeleton).predict(history, 1 / 30, lead)


def test_somebody_who_glides_glides_on() -> None:
    predicted = predict(gliding()).joints_m[4, 1].mean(axis=0)
    expected = (STANDING + [2, 14 * 0.04, 0]).mean(axis=0)
    np.testing.assert_allclose(predicted, expected, atol=0.06)  # of 0.2 m that they go


def test_place_and_heading_in_the_room_change_nothing() -> None:
    history = gliding()
    angle = 2.1
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    shift = np.array([31.0, -17.0, 2.5])
    moved = predict(history @ turn.T + shift).joints_m
    np.testing.assert_allclose(moved, predict(history).joints_m @ turn.T + shift, atol=1e-4)


def test_only_the_newest_slots_count() -> None:
    history = gliding(num_slots=25)
    np.testing.assert_array_equal(predict(history).joints_m, predict(history[-10:]).joints_m)


def test_a_value_in_place_of_missing_is_never_used() -> None:
    history = gliding()
    history[3:6, :, 9] = np.nan
    with_nan = predict(history).joints_m
    history[3:6, :, 9, 0] = np.inf  # not finite, or light years away: missing all the same
    history[3:6, :, 9, 1:] = 1e300
    np.testing.assert_array_equal(predict(history).joints_m, with_nan)


def test_expected_error_rises_with_lead_and_noise() -> None:
    history = gliding()
    exact = predict(history).error_m
    assert (exact[9, 1:] > exact[0, 1:]).all()
    noise = np.random.default_rng(0).normal(0, 0.02, history.shape)
    assert predict(history + noise).error_m[0].mean() > 3 * exact[0].mean()


def test_a_lost_joint_moves_with_its_person() -> None:
    history = gliding()
    history[-3:, 1, 13] = np.nan  # the left knee
    predicted = predict(history, lead=1).joints_m[0, 1, 13]
    np.testing.assert_allclose(predicted, STANDING[13] + [2, 0.4, 0], atol=0.03)


@pytest.mark.parametrize("skeleton", [BODY25, CMU31], ids=lambda s: s.name)
def test_other_joints_are_carried_with_the_nearest(skeleton: Skeleton) -> None:
    history = gliding()
    converted = convert(history, np.ones(history.shape[:-1]), COCO17, skeleton)[0]
    extra = "left_big_toe" if skeleton == BODY25 else "left_toes"
    ankle, toe = skeleton.index("left_ankle"), skeleton.index(extra)
    converted[:, :, toe] = converted[:, :, ankle] + [0.0, 0.1, -0.05]
    prediction = predict(converted, skeleton=skeleton)
    offset = prediction.joints_m[:, :, toe] - prediction.joints_m[:, :, ankle]
    np.testing.assert_allclose(offset, np.broadcast_to([0, 0.1, -0.05], offset.shape), atol=1e-9)
    np.testing.assert_array_equal(prediction.error_m[..., toe], prediction.error_m[..., ankle])


@each_case("name", [n for n, one in SKELETONS.items() if {*one.joints} >= BODY_JOINTS])
def test_every_skeleton_of_a_body_is_served(name: str) -> None:
    history = np.random.default_rng(0).normal(size=(10, 2, len(SKELETONS[name]), 3))
    assert np.isfinite(predict(history, skeleton=SKELETONS[name]).joints_m).all()


def test_somebody_without_a_common_joint_stays_where_they_are() -> None:
    history = gliding()
    history[:, 1] = np.nan
    history[:, 1, 3] = [1.0, 2.0, 3.0]  # an ear
    joints = predict(history).joints_m[:, 1]
    np.testing.assert_array_equal(joints[:, 3], np.broadcast_to([1.0, 2.0, 3.0], (10, 3)))
    assert np.isnan(joints[:, :3]).all()


@each_case("interval_s", [1 / 60, 1 / 30, 1 / 5])
def test_any_frame_rate_glides_on(interval_s: float) -> None:
    history = gliding(speed_m=1.2 * interval_s)
    prediction = make_predictor("attention-lstm").predict(history, interval_s, 3)
    moved = prediction.joints_m[2, 1].mean(axis=0) - history[-1, 1].mean(axis=0)
    np.testing.assert_allclose(moved, [0, 3.6 * interval_s, 0], atol=1.3 * interval_s)


@pytest.mark.parametrize("interval_s", [1e-9, 1e9])
def test_an_unknown_frame_rate_counts_as_the_nearest_known(interval_s: float) -> None:
    predictor, history = make_predictor("attention-lstm"), gliding()
    nearest = 1 / 60 if interval_s < 1 else 1 / 5
    wanted = predictor.predict(history, nearest, 5).joints_m
    np.testing.assert_array_equal(predictor.predict(history, interval_s, 5).joints_m, wanted)


def test_hundreds_of_people_stay_far_ahead_where_the_last_lead_has_them() -> None:
    history = np.tile(gliding(), (1, 70, 1, 1))
    prediction = predict(history, lead=MAX_LEADS + 40)
    assert np.isfinite(prediction.joints_m).all()
    np.testing.assert_array_equal(prediction.joints_m[-1], prediction.joints_m[MAX_LEADS - 1])


def test_weights_are_small() -> None:
    assert SHIPPED.stat().st_size < 3_000_000


@each_case("damage", ["missing", "empty", "truncated", "text", "flipped"])
def test_damaged_weights_are_refused(tmp_path: Path, damage: str) -> None:
    content = SHIPPED.read_bytes()
    path = tmp_path / "w.onnx"
    spoilt = {
        "empty": b"",
        "truncated": content[: len(content) // 2],
        "text": b"hello" * 1000,
        "flipped": bytes(255 - b for b in content[:200]) + content[200:],
    }
    if damage != "missing":
        path.write_bytes(spoilt[damage])
    with pytest.raises(InputError, match=r"w\.onnx"):
        AttentionLstm(COCO17, path)


@each_case(
    ("key", "found", "wanted"),
    [
        ("format", b"e3pose attention-lstm", b"e4pose attention-lstm"),
        ("joints", b"left_hip right_hip", b"right_hip left_hip"),
        ("version", b"\x07version\x12\x012", b"\x07version\x12\x011"),
        ("history_slots", b"history_slots\x12\x0210", b"history_slots\x12\x0212"),
        ("history_slots", b"history_slots\x12\x0210", b"history_slots\x12\x02-1"),
        ("error_factor", rb"\[1\.0, 1", b"[-.0, 1"),
        ("error_factor", rb"\[1\.0, 1", b"[-1., 1"),
        ("error_curve", rb"\[\[\[-", b"[[[+"),
        ("error_curve", rb"\[\[\[-\d", b"[[[99"),
        ("error_factor", b"error_factor", b"error_vector"),
        ("network", b"log_error", b"lag_error"),
        ("", b"features", b"fixtures"),  # its first input renamed
    ],
)
def test_weights_of_another_kind_are_refused(
    tmp_path: Path, key: str, found: bytes, wanted: bytes
) -> None:
    content = SHIPPED.read_bytes()
    changed, count = re.subn(found, wanted, content)
    assert count
    path = tmp_path / "w.onnx"
    path.write_bytes(changed)
    with pytest.raises(InputError, match=rf"w\.onnx: {key}"):
        AttentionLstm(COCO17, path)


def test_the_edge_goes_on_without_weights_and_says_so_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"nothing")
    monkeypatch.setattr(AttentionLstm.__init__, "__defaults__", (broken,))
    with caplog.at_level(logging.WARNING):
        first = make_predictor_or_fallback("attention-lstm")
        make_predictor_or_fallback("attention-lstm")
    assert isinstance(first, ConstantVelocity)
    assert len([r for r in caplog.records if "broken.onnx" in r.message]) == 1
