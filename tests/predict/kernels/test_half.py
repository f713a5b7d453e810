"""Weights in half precision: nothing is lost where they are widened."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case

from e3pose.base.kernel import kernel
from e3pose.model.skeleton import COCO17
from e3pose.predict.attention_lstm import PUBLISHED, SHIPPED, AttentionLstm
from e3pose.predict.kernels.half import Halves, in_half, widen
from e3pose.predict.weights_file import read_file

Floats32 = NDArray[np.float32]


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
