"""Constants that kernels take as one pointer."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from e3pose.base.kernel import kernel
from e3pose.base.kernel_arguments import Held


class Inner(NamedTuple):
    values: NDArray[np.float64]
    factor: float


class Outer(NamedTuple):
    inner: Inner
    rows: NDArray[np.int64]


@kernel
def scale(held: Held[Outer]) -> float:
    outer = held.values
    for row in outer.rows:
        outer.inner.values[row] *= outer.inner.factor
    return float(outer.inner.values.sum())


def test_a_kernel_works_on_the_arrays_that_are_held() -> None:
    values = np.arange(4.0)
    held = Held(Outer(Inner(values, 3.0), np.array([1, 3])))
    assert scale(held) == 3.0 + 2.0 + 9.0
    np.testing.assert_array_equal(values, [0.0, 3.0, 2.0, 9.0])


def test_other_values_of_the_same_kinds_need_no_other_kernel() -> None:
    for factor in (1.0, 2.0):
        scale(Held(Outer(Inner(np.ones(3), factor), np.array([0]))))
    assert len(scale.compiled.signatures) == 1  # type: ignore[attr-defined]


def test_arrays_live_as_long_as_what_holds_them() -> None:
    held = Held(Outer(Inner(np.ones(1000), 1.0), np.zeros(0, dtype=np.int64)))
    np.full(1000, 7.0)
    assert scale(held) == 1000.0
