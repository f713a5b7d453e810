"""A kernel that another one calls is a part of it, and a kernel of its own for Python."""

from __future__ import annotations

import gc
import math
import sys
from typing import Any

import numpy as np
import pytest

from e3pose.base.arrays import Floats
from e3pose.base.dispatcher import Part, Whole
from e3pose.base.kernel import INTERPRETING, kernel


@kernel
def double(values: Floats, index: int) -> float:
    return 2 * float(values[index])


@kernel
def head(values: Floats, count: int) -> Any:
    return values[:count]


@kernel
def summed(values: Floats, start: int) -> float:
    total = 0.0
    for index in range(start, len(values)):
        total += double(values, index)
    return total


@kernel
def checked(values: Floats) -> float:
    if len(values) == 0:
        raise ValueError("no values")
    return summed(values, 0) + summed(head(values, 2), 1)


@kernel
def outer(values: Floats) -> float:
    room = np.zeros(3)
    for row in range(3):
        room[row] = checked(values[row:])
    return float(room.sum())


@kernel
def without_domain(value: float) -> tuple[float, float, float]:
    return 1.0 / math.sqrt(value), math.log(value), math.exp(1e3 + value)


def test_interpreted_kernels_go_on_where_python_would_not(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = [without_domain(value) for value in (-1.0, 0.0, 4.0)]
    monkeypatch.setattr(INTERPRETING, "on", True)
    with np.errstate(all="ignore"):
        interpreted = [without_domain(value) for value in (-1.0, 0.0, 4.0)]
    np.testing.assert_allclose(interpreted, compiled, rtol=1e-15)
    assert np.isnan(compiled[0][0]) and compiled[1][:2] == (np.inf, -np.inf)


def forms(function: Any) -> list[type]:
    return [type(found.library) for found in function.compiled.overloads.values()]


def test_what_a_kernel_calls_is_a_part_until_python_calls_it() -> None:
    values = np.arange(4.0)
    assert outer(values) == 12 + 12 + 10 + (2 + 4 + 6)
    if forms(double):  # compiled now, not loaded from disk
        assert set(forms(double)) == {Part} and set(forms(outer)) == {Whole}
    assert double(values, 3) == 6.0
    assert Whole in forms(double)
    assert outer(values) == 46


def test_an_error_in_a_part_is_raised_as_in_python() -> None:
    with pytest.raises(ValueError, match="no values"):
        outer(np.arange(2.0))


def test_constants_of_a_call_make_no_other_part() -> None:
    """`summed` is called with 0 and with 1."""
    outer(np.arange(4.0))
    assert len(forms(summed)) <= 1


def test_arrays_of_parts_are_neither_freed_nor_kept() -> None:
    values = np.arange(4.0)
    before = sys.getrefcount(values)
    for _ in range(2000):
        outer(values)
    gc.collect()
    assert sys.getrefcount(values) == before
    np.testing.assert_array_equal(values, np.arange(4.0))
