"""The shipped weights on real motion that they never saw, beside the simple predictors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from e3pose.base.arrays import Floats
from e3pose.model.skeleton import CMU31
from e3pose.predict import PREDICTORS, make_predictor
from e3pose_lab.datasets.motion import import_cmu
from e3pose_lab.datasets.panoptic import import_panoptic
from e3pose_lab.prediction.compare import evaluate_motion, motion_of, pooled
from e3pose_lab.prediction.motion import body_errors, body_joints
from e3pose_lab.prediction.scores import PredictionSettings
from e3pose_lab.prediction.tally import figures
from e3pose_lab.train.windows import estimation_noise

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
pytestmark = [pytest.mark.shared, pytest.mark.parity]

HELD_OUT = ("01_06", "01_14", "02_02", "02_07")  # the clips that the model card names
HISTORY, LEADS = 10, 15
SIMPLE = sorted(name for name in PREDICTORS if name.endswith("velocity"))


def windows(shared: Path) -> tuple[Floats, Floats]:
    """Return histories and futures `(num_slots, num_windows, 31, 3)` of the held-out clips."""
    source = shared / "data" / "cmu_mocap" / "cmu_mocap_train_30fps.npz"
    pieces = []
    for clip in HELD_OUT:
        truth = import_cmu(source, clip).truth
        assert truth is not None
        joints = truth.joints_m[:, 0]
        starts = np.arange(0, len(joints) - HISTORY - LEADS + 1, 4)
        pieces.append(joints[starts[:, None] + np.arange(HISTORY + LEADS)])
    both = np.concatenate(pieces).swapaxes(0, 1)
    return both[:HISTORY], both[HISTORY:]


def errors(name: str, history: Floats, future: Floats) -> Floats:
    """Return the mean error `(LEADS,)` over fourteen joints in metres."""
    predicted = make_predictor(name, CMU31).predict(history, 1 / 30, LEADS).joints_m
    apart = body_joints(predicted, CMU31) - body_joints(future, CMU31)
    return np.asarray(np.nanmean(np.linalg.norm(apart, axis=-1), axis=(1, 2)))


def spoilt(history: Floats) -> Floats:
    rng = np.random.default_rng(0)
    size = history.shape[1]
    noise = estimation_noise(HISTORY, np.full(size, 0.0346), np.full(size, 1 / 30), rng)
    noisy = history + noise[:, :, rng.integers(0, 14, history.shape[2])]
    noisy[rng.random(noisy.shape[:3]) < 0.2] = np.nan
    return noisy


def test_exact_histories_beat_every_simple_predictor_at_every_lead(shared: Path) -> None:
    history, future = windows(shared)
    ours = errors("attention-lstm", history, future)
    simple = {name: errors(name, history, future) for name in SIMPLE}
    for name, theirs in simple.items():
        assert (ours < theirs).all(), name
    assert ours[9] < 0.57 * simple["constant-velocity"][9]


def test_noisy_histories_beat_every_simple_predictor_at_every_lead(shared: Path) -> None:
    history, future = windows(shared)
    history = spoilt(history)
    ours = errors("attention-lstm", history, future)
    best = np.min([errors(name, history, future) for name in SIMPLE], axis=0)
    assert (ours < 0.87 * best).all()
    assert (ours[4:] < 0.70 * best[4:]).all()


def test_the_papers_network_is_ahead_of_no_motion_on_people_it_never_saw(shared: Path) -> None:
    folder = shared / "data" / "panoptic"
    recording = import_panoptic(
        folder / "171026_pose3_train.npz", calibration=folder / "160906_band1.npz"
    )
    leads = (4, 5, 6, 8, 10, 15)
    names = ["attention-lstm-paper", "zero-velocity"]
    each = evaluate_motion(motion_of(recording), names, PredictionSettings(leads, every=10))
    for histories, parts in pooled([each], len(leads)).items():
        ours, still = (figures(parts[name], leads) for name in names)
        for lead in map(str, leads):
            assert ours["mpjpe_mm"][lead] < still["mpjpe_mm"][lead], (histories, lead)
            if int(lead) <= 10:  # at 15 slots boxes are level
                assert ours["box_iou"][lead] > still["box_iou"][lead], (histories, lead)


def test_expected_errors_are_honest(shared: Path) -> None:
    history, future = windows(shared)
    for given in (history, spoilt(history)):
        prediction = make_predictor("attention-lstm", CMU31).predict(given, 1 / 30, LEADS)
        expected = body_errors(prediction.error_m, CMU31).ravel()
        apart = body_joints(prediction.joints_m, CMU31) - body_joints(future, CMU31)
        actual = np.linalg.norm(apart, axis=-1).ravel()
        known = np.isfinite(expected) & np.isfinite(actual)
        expected, actual = expected[known], actual[known]
        order = np.argsort(expected)
        for group in np.array_split(order, 5):  # from confident to unsure
            assert 0.7 < actual[group].mean() / expected[group].mean() < 1.4
