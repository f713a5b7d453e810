"""Numbers in half precision: what weights take in memory, widened where a kernel uses them.

numba has no arrays of half precision, so their bits are held as integers of 16.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

Halves = NDArray[np.int16]  # the bits of numbers in half precision


@intrinsic  # type: ignore[untyped-decorator]
def widen(typing: Any, bits: Any) -> Any:
    """Return an element of `Halves` in single precision, exactly."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fpext(builder.bitcast(arguments[0], ir.HalfType()), ir.FloatType())

    return (types.float32(types.int16), generate) if bits == types.int16 else None


def in_half(numbers: NDArray[np.float32]) -> Halves:
    """Return numbers, rounded to half precision.

    Raises:
        ValueError: for numbers that are too large for it, or none.
    """
    with np.errstate(over="ignore"):
        halves = numbers.astype(np.float16)
    if not np.isfinite(halves).all():
        raise ValueError(f"a weight of {np.abs(numbers).max():g}")
    return np.ascontiguousarray(halves).view(np.int16)
