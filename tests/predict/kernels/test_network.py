"""The compiled network against ONNX Runtime, which runs the graph in the file of weights."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case
from tests.reference import attention_network as runtime

from e3pose.model.skeleton import COCO17
from e3pose.predict.attention_lstm import AttentionLstm, read_curves
from e3pose.predict.kernels.half import in_half
from e3pose.predict.kernels.layers import linear, sigmoid, soften, tanh
from e3pose.predict.kernels.network import run_network
from e3pose.predict.kernels.tracks import calibrated
from e3pose.predict.normalise import NUM_COMMON
from e3pose_lab.prediction.normalise import normalise

pytest.importorskip(
    "onnxruntime", reason="onnxruntime is not installed: pip install e3pose[camera]"
)

NETWORK_M = 1e-5  # single precision, in another order of sums
Floats32 = NDArray[np.float32]


@each_case("num_people", [1, 3, 4, 5, 8])
@each_case("leads", [1, 6])
def test_the_network_says_what_onnx_runtime_says(num_people: int, leads: int) -> None:
    rng = np.random.default_rng(10 * num_people + leads)
    pose = rng.normal(scale=0.4, size=(num_people, NUM_COMMON, 3))
    history = pose + np.cumsum(rng.normal(scale=0.03, size=(10, *pose.shape)), axis=0)
    history[rng.random(history.shape[:3]) < 0.2] = np.nan
    normal = normalise(history, 0.04, 10)
    places = np.empty((leads, num_people, 3 * NUM_COMMON), dtype=np.float32)
    log_error = np.empty((leads, num_people, NUM_COMMON), dtype=np.float32)
    weights = AttentionLstm(COCO17).weights
    run_network(weights, normal.features, normal.context, places, log_error)
    expected, expected_log = runtime.run_network(runtime.open_session(), normal, leads)
    np.testing.assert_allclose(places, expected, atol=NETWORK_M)
    np.testing.assert_allclose(log_error, expected_log, atol=1e-4)


def test_curves_are_within_single_precision() -> None:
    for x in np.linspace(-30, 30, 2001).astype(np.float32):
        assert abs(tanh(x) - np.tanh(np.float64(x))) < 3e-7
        assert abs(sigmoid(x) - 1 / (1 + np.exp(-np.float64(x)))) < 3e-7


@each_case("num_rows", range(1, 10))
@each_case("num_inputs", [1, 4, 7])
def test_a_linear_layer_of_any_size(num_rows: int, num_inputs: int) -> None:
    rng = np.random.default_rng(num_rows)

    def drawn(*shape: int) -> Floats32:
        return rng.normal(size=shape).astype(np.float32)

    rows, weight, bias = drawn(num_rows, num_inputs), drawn(num_inputs, 5), drawn(5)
    out = np.full((num_rows, 5), np.nan, dtype=np.float32)
    linear(rows, in_half(weight), bias, out)
    rounded = weight.astype(np.float16).astype(np.float32)
    np.testing.assert_allclose(out, rows @ rounded + bias, atol=1e-5)


def test_softmax_of_large_numbers() -> None:
    values = np.array([500.0, 501.0, -500.0], dtype=np.float32)
    soften(values)
    np.testing.assert_allclose(values, [1 / (1 + np.e), np.e / (1 + np.e), 0], atol=1e-6)


def test_expected_errors_are_interpolated_as_in_numpy() -> None:
    curve = [[[-4.0, -3.0, -1.0]], [[-5.0, -3.0, -2.5]]]
    curves = read_curves({"error_factor": "[2.0]", "error_curve": json.dumps(curve)})
    for log_error in np.linspace(-4, -1, 31):
        expected = 2 * np.exp(np.interp(log_error, curve[0][0], curve[1][0]))
        assert calibrated(log_error, 3, curves) == pytest.approx(expected)
