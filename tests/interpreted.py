"""Kernels as plain Python: a law on a few numbers, for which compiling would take seconds.

What is compiled of them is a part of a larger kernel, of a slot or of a prediction, which other
tests compare with plain numpy.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numpy as np
import pytest

from e3pose.base.kernel import INTERPRETING

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def interpreted(kernel: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Return a kernel, or what calls some, that compiles none and warns of no number."""

    def call(*args: Parameters.args, **named: Parameters.kwargs) -> Result:
        with pytest.MonkeyPatch.context() as patched, np.errstate(all="ignore"):
            patched.setattr(INTERPRETING, "on", True)
            return kernel(*args, **named)

    return call
