"""How every kernel is compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def kernel(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Compile a function: cached on disk, free of the interpreter lock, division as in numpy.

    Of the fast-math flags only `contract` is safe: it fuses a product and a sum, with one rounding
    where the reference has two. Reordering or ignoring NaN would break the agreement.
    """
    jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
    return cast(Callable[Parameters, Result], jit(function))
