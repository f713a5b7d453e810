"""Prediction figures against motion and predictors whose errors are known."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.model.skeleton import COCO17
from e3pose.predict.base import Prediction, Predictor
from e3pose.predict.velocities import ConstantVelocity, ZeroVelocity
from e3pose_lab.prediction.compare import evaluate_motion, pooled
from e3pose_lab.prediction.motion import Motion
from e3pose_lab.prediction.scores import (
    PredictionSettings,
    conditions,
    latencies_ms,
    score,
    window_ends,
)
from e3pose_lab.prediction.tally import Tally, calibration, figures

STEP_M = 0.03


@dataclass(frozen=True)
class Shifted:
    """Stays where people are, off by a fixed distance, and states an error."""

    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    claim_m: float = np.nan
    lost: list[int] = field(default_factory=list)

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        joints = np.repeat(history_m[-1:], lead_slots, axis=0) + self.shift_m
        joints[:, :, self.lost] = np.nan
        return Prediction(joints, np.full(joints.shape[:-1], self.claim_m))


def _rig() -> Rig:
    """One camera 10 m before the origin at its height, looking along y: 100 px a metre there."""
    K = np.array([[1000.0, 0, 500], [0, 1000, 500], [0, 0, 1]])
    R = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return Rig((Camera.from_world_to_camera("c", (1001, 1001), K, R, [0.0, 0.0, 10.0]),))


def _flat_body() -> Floats:
    """COCO-17 in the plane y = 0, one metre square."""
    body = np.random.default_rng(0).uniform(-0.4, 0.4, size=(17, 3))
    body[:, 1] = 0.0
    body[5], body[16] = [-0.5, 0, 0.5], [0.5, 0, -0.5]  # a shoulder and an ankle span it
    return body


def _motion(*people: Floats) -> Motion:
    return Motion("test", "truth", COCO17, _rig(), 1 / 30, people)


def _walking(num_slots: int = 30) -> Floats:
    steps = STEP_M * np.arange(num_slots)[:, None, None] * np.array([1.0, 0.0, 0.0])
    return np.asarray(_flat_body() + steps)


def _figures(
    predictor: Predictor, motion: Motion, settings: PredictionSettings
) -> dict[str, dict[str, float]]:
    total = Tally.zero(len(settings.leads))
    for _, part in score(predictor, motion, motion.people, settings):
        total += part
    return figures(total, settings.leads)


STILL = np.repeat(_flat_body()[None], 30, axis=0)


def test_uniform_motion_is_foreseen_exactly_by_constant_velocity_alone() -> None:
    settings = PredictionSettings(leads=(1, 7))
    found = _figures(ConstantVelocity(), _motion(_walking()), settings)
    assert found["mpjpe_mm"] == pytest.approx({"1": 0.0, "7": 0.0}, abs=1e-9)
    assert found["box_iou"] == pytest.approx({"1": 1.0, "7": 1.0})
    assert found["coverage"] == {"1": 1.0, "7": 1.0}
    found = _figures(ZeroVelocity(), _motion(_walking()), settings)
    assert found["mpjpe_mm"] == pytest.approx({"1": 30.0, "7": 210.0})
    assert found["root_relative_mpjpe_mm"] == pytest.approx({"1": 0.0, "7": 0.0}, abs=1e-9)
    claimed = {"expected_mm", "within_expected", "within_twice_expected"}
    assert not claimed & set(found), "a predictor that claims nothing has no honesty"


@each_case(("shift_m", "iou"), [(0.55, 1 / 3), (50.0, 0.0)])
def test_boxes_are_expanded_by_a_tenth_before_they_overlap(shift_m: float, iou: float) -> None:
    """Boxes 1.1 m wide, half a width apart, share a third of their union; out of view nothing."""
    found = _figures(Shifted((shift_m, 0, 0)), _motion(STILL), PredictionSettings(leads=(1,)))
    assert found["box_iou"]["1"] == pytest.approx(iou, abs=1e-6)


def test_people_out_of_view_have_no_boxes() -> None:
    found = _figures(ZeroVelocity(), _motion(STILL + [0, 0, 50.0]), PredictionSettings(leads=(1,)))
    assert "box_iou" not in found
    assert found["mpjpe_mm"] == {"1": 0.0}


def test_joints_that_are_unknown_later_do_not_count() -> None:
    walk = _walking()
    walk[:, 9] = np.nan  # a wrist never known, the nose gone in the end
    walk[20:, 0] = np.nan
    found = _figures(ZeroVelocity(), _motion(walk), PredictionSettings(leads=(1,)))
    assert found["mpjpe_mm"]["1"] == pytest.approx(30.0)
    assert found["coverage"]["1"] == 1.0


def test_joints_that_were_not_predicted_lower_the_coverage() -> None:
    found = _figures(Shifted(lost=[9]), _motion(STILL), PredictionSettings(leads=(1, 2)))
    assert found["coverage"] == pytest.approx({"1": 13 / 14, "2": 13 / 14})
    assert found["mpjpe_mm"]["1"] == 0.0


@pytest.mark.parametrize(("claim", "within", "twice"), [(0.09, 0, 0), (0.11, 0, 1), (0.21, 1, 1)])
def test_honesty_is_the_share_of_joints_within_the_stated_error(
    claim: float, within: float, twice: float
) -> None:
    predictor = Shifted((0, 0, 0.2), claim)
    found = _figures(predictor, _motion(STILL), PredictionSettings(leads=(1,)))
    assert found["expected_mm"]["1"] == pytest.approx(1000 * claim)
    assert found["within_expected"]["1"] == within
    assert found["within_twice_expected"]["1"] == twice


def test_stated_errors_stand_beside_actual_ones_in_groups_of_alike() -> None:
    total = Tally.zero(2)
    for claim in (0.05, 0.07, 0.5):
        parts = score(
            Shifted((0, 0, 0.2), claim), _motion(STILL), [STILL], PredictionSettings(leads=(1, 2))
        )
        for _, part in parts:
            total += part
    near, far = calibration(total)
    joints = 13 * (20 + 19)  # the neck is a mean and has no stated error
    assert near == pytest.approx({"expected_mm": 60, "actual_mm": 200, "joints": 2 * joints})
    assert far == pytest.approx({"expected_mm": 500, "actual_mm": 200, "joints": joints})
    assert calibration(Tally.zero(2)) == []


def test_windows_need_a_person_in_every_slot_of_the_history() -> None:
    walk = _walking(30)
    walk[12] = np.nan
    ends = window_ends(walk, PredictionSettings(history_slots=5))
    assert ends.tolist() == [*range(4, 12), *range(17, 29)]  # slot 29 has no future
    assert window_ends(walk, PredictionSettings(history_slots=5, every=4)).tolist() == [
        4, 8, 17, 21, 25,
    ]  # fmt: skip
    assert len(window_ends(walk, PredictionSettings(history_slots=30))) == 0


def test_every_lead_has_all_windows_whose_future_is_known() -> None:
    settings = PredictionSettings(leads=(1, 20))
    total = Tally.zero(2)
    for _, part in score(ZeroVelocity(), _motion(_walking(30)), [_walking(30)], settings):
        total += part
    assert total.windows.tolist() == [20, 1]
    found = _figures(ZeroVelocity(), _motion(_walking(15)), PredictionSettings(leads=(1, 9)))
    assert set(found["mpjpe_mm"]) == {"1"}, "a lead without a known future is absent"


def test_pooling_weighs_every_joint_alike() -> None:
    settings = PredictionSettings(leads=(1,))
    slow = _motion(np.repeat(_flat_body()[None], 41, axis=0))  # 31 windows
    fast = _motion(_walking(21))  # 11 windows, off by 30 mm
    each = [evaluate_motion(motion, ["zero-velocity"], settings) for motion in (slow, fast)]
    total = pooled(each, 1)["exact"]["zero-velocity"]
    assert figures(total, (1,))["mpjpe_mm"]["1"] == pytest.approx(30 * 11 / 42)


def test_more_windows_than_a_batch_are_all_scored() -> None:
    settings = PredictionSettings(leads=(1,), history_slots=2)
    parts = list(score(ZeroVelocity(), _motion(_walking(700)), [_walking(700)], settings))
    assert sum(count for count, _ in parts) == 698
    assert sum(part.windows[0] for _, part in parts) == 698


def test_noise_makes_predictions_worse_and_is_the_same_for_all() -> None:
    settings = PredictionSettings(leads=(1,), noise_m=0.02)
    motion = _motion(_walking(300))
    live = replace(motion, source="estimates")
    assert set(conditions(live, settings)) == {"estimated"}, "taken as they are"
    first = evaluate_motion(motion, ["zero-velocity", "constant-velocity"], settings)
    again = evaluate_motion(motion, ["constant-velocity"], settings)
    exact, noisy = (
        figures(first[c]["constant-velocity"], (1,))["mpjpe_mm"]["1"] for c in ("exact", "noisy")
    )
    assert exact < 1e-6
    assert noisy > 20
    same = figures(again["noisy"]["constant-velocity"], (1,))["mpjpe_mm"]["1"]
    assert same == noisy


def test_a_motion_too_short_to_predict_is_named() -> None:
    with pytest.raises(InputError, match="found nobody in 10 consecutive slots"):
        evaluate_motion(_motion(_walking(10)), ["zero-velocity"], PredictionSettings())
    with pytest.raises(InputError, match="found nobody"):
        evaluate_motion(_motion(), ["zero-velocity"], PredictionSettings())


def test_latency_is_the_time_of_calls_alone() -> None:
    ticks = iter(np.cumsum([0.0, 0.001] * 60).tolist())
    times = latencies_ms(
        ZeroVelocity(), np.zeros((10, 4, 17, 3)), 1 / 30, (1, 5), lambda: next(ticks), repeats=20
    )
    assert {lead: round(each["median"], 6) for lead, each in times.items()} == {"1": 1.0, "5": 1.0}


@pytest.mark.shared
@pytest.mark.parity
def test_baselines_on_motion_capture_match_reference_figures(shared: Path) -> None:
    """All clips, 14 joints, exact histories of 10 frames: leads 1 and 10, by other code."""
    from e3pose_lab.datasets.motion import cmu_clips, import_cmu
    from e3pose_lab.prediction.compare import motion_of

    reference = {
        "zero-velocity": (19.7, 176.3),
        "constant-velocity": (6.4, 137.1),
        "damped-velocity": (8.1, 132.6),
    }
    source = shared / "data/cmu_mocap/cmu_mocap_train_30fps.npz"
    settings = PredictionSettings(leads=(1, 10), noise_m=0.0, missing=0.0)
    motions = [motion_of(import_cmu(source, clip)) for clip in cmu_clips(source)]
    each = [evaluate_motion(motion, list(reference), settings) for motion in motions]
    for name, part in pooled(each, 2)["exact"].items():
        mpjpe = figures(part, settings.leads)["mpjpe_mm"]
        assert (mpjpe["1"], mpjpe["10"]) == pytest.approx(reference[name], abs=0.06)
