"""The compiled network and what it takes and gives, against ONNX Runtime and plain numpy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case
from tests.interpreted import interpreted
from tests.reference import attention_network as runtime
from tests.reference import normalise as plain_history

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.model.skeleton import BODY25, COCO17
from e3pose.predict.attention_lstm import PUBLISHED, SHIPPED, AttentionLstm
from e3pose.predict.kernels.half import Halves, in_half, widen
from e3pose.predict.kernels.layers import linear, sigmoid, soften, tanh
from e3pose.predict.kernels.tracks import calibrated
from e3pose.predict.normalise import NUM_COMMON
from e3pose.predict.weights_file import read_file
from e3pose_lab.prediction.normalise import Normalised, normalise

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
    predictor = AttentionLstm(BODY25)
    columns = predictor.joints.direct
    joints_m = np.full((10, num_people, len(BODY25), 3), np.nan)
    joints_m[:, :, columns] = history
    found = predictor.predict(joints_m, 0.04, leads)
    normal = plain_history.normalise(history, 0.04, 10)
    places, log_error = runtime.run_network(runtime.open_session(), normal, leads)
    places_m = np.moveaxis(places.reshape(leads, num_people, 3, NUM_COMMON), 2, 3)
    expected_m = plain_history.to_world(normal, places_m.astype(np.float64))
    np.testing.assert_allclose(found.joints_m[:, :, columns], expected_m, atol=NETWORK_M)
    error = interpreted(calibrated)
    curves = predictor.curves
    errors_m = [[[error(x, n, curves) for x in row] for row in log_error[n]] for n in range(leads)]
    flattest = curves.slopes.min()  # of the curves: an error of 1e-4 before them is this much after
    np.testing.assert_allclose(
        np.log(found.error_m[:, :, columns]), np.log(errors_m), atol=1e-4 * flattest
    )


@each_case("curve, plain", [(tanh, np.tanh), (sigmoid, lambda x: 1 / (1 + np.exp(-x)))])
def test_curves_are_within_single_precision(
    curve: Callable[[np.float32], np.float32], plain: Callable[[np.float64], np.float64]
) -> None:
    for x in np.linspace(-30, 30, 2001).astype(np.float32):
        assert abs(interpreted(curve)(x) - plain(np.float64(x))) < 3e-7


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
    interpreted(soften)(values)
    np.testing.assert_allclose(values, [1 / (1 + np.e), np.e / (1 + np.e), 0], atol=1e-6)


def histories(seed: int, num_slots: int = 10) -> Floats:
    """Return people with gaps, one who is missing and joints that are light years away."""
    rng = np.random.default_rng(seed)
    people = rng.normal(scale=0.4, size=(6, NUM_COMMON, 3))
    walk = np.cumsum(rng.normal(scale=0.02, size=(num_slots, 6, NUM_COMMON, 3)), axis=0)
    history = people + walk
    history[rng.random(history.shape[:3]) < 0.3] = np.nan
    history[:, 1] = np.nan
    history[:, 2, 4] = np.nan
    history[3, 3] = np.nan
    history[5, 4, :3] = 1e6
    history[:, 5, :4] = 0.25  # no width: faces nowhere
    return history


@each_case("num_slots", [1, 4, 10, 13])
@each_case("interval_s", [1 / 25, 1e-3, 2.0])
def test_people_are_described_as_in_numpy(num_slots: int, interval_s: float) -> None:
    history = histories(num_slots, num_slots=max(num_slots, 6))[:num_slots]
    found, expected = (
        form(history, interval_s, 10) for form in (interpreted(normalise), plain_history.normalise)
    )
    for name in Normalised.__dataclass_fields__:
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=2e-6, atol=1e-6, err_msg=name
        )


def test_people_may_have_intervals_of_their_own() -> None:
    intervals_s = np.linspace(0.02, 0.1, 6)
    found = interpreted(normalise)(histories(0), intervals_s, 10).context[:, 1]
    np.testing.assert_allclose(found, np.log(30 * intervals_s), rtol=1e-6)


@kernel
def widen_all(weights: Halves, out: Floats32) -> None:
    for i in range(len(weights)):
        out[i] = widen(weights[i])


def test_every_number_of_half_precision_is_widened_exactly() -> None:
    bits = np.arange(-(2**15), 2**15).astype(np.int16)
    out = np.empty(len(bits), np.float32)
    widen_all(bits, out)
    np.testing.assert_array_equal(out, bits.view(np.float16).astype(np.float32))


def test_numbers_are_rounded_to_the_nearest() -> None:
    numbers = np.array([0.1, -0.5, 1023.5, 2.0**-24], np.float32)
    np.testing.assert_array_equal(in_half(numbers).view(np.float16), numbers.astype(np.float16))


@each_case("number", [1e6, -np.inf, np.nan])
def test_numbers_that_half_precision_does_not_hold_are_refused(number: float) -> None:
    with pytest.raises(ValueError, match="a weight of"):
        in_half(np.array([0.0, number], np.float32))


@pytest.mark.parametrize("path", [SHIPPED, PUBLISHED], ids=["shipped", "published"])
def test_the_shipped_networks_lose_nothing(path: Path) -> None:
    matrices = [one for one in read_file(path.read_bytes()).tensors if one.ndim > 1]
    assert sum(one.size for one in matrices) > 200_000
    for one in matrices:
        np.testing.assert_array_equal(in_half(one).view(np.float16).astype(np.float32), one)


def test_matrices_are_held_in_half_precision() -> None:
    for part in AttentionLstm(COCO17).weights:
        assert part.dtype == (np.int16 if part.ndim == 2 else np.float32)
