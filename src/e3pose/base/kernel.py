"""Kernels: functions that are compiled when they are first called.

Declaring one imports no compiler, so a law, its constants and its kernel stand in one file that
programs without a slot to compute may import: numba takes a second to import, and cameras and
`check` do without it.

While kernels are compiled elsewhere a thread may interpret them (`INTERPRETING`): some hundred
times as slow, and the same but for the last digits, as a product and a sum are then rounded apart.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from functools import update_wrapper
from importlib import import_module
from types import FunctionType, SimpleNamespace
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np

from e3pose.base.compiling import COMPILING

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

LANES = 16  # the innermost loops run over so many poses, which fills a vector register
# As compiled code has them: without a domain, and so that what is made of them divides by 0.
_MATH = SimpleNamespace(**vars(math))
for _name in ("exp", "log", "log1p", "sqrt", "tan", "tanh"):
    setattr(_MATH, _name, getattr(np, _name))


class Interpreting(threading.local):
    """Whether kernels are interpreted, in this thread."""

    on = False


INTERPRETING = Interpreting()


class Kernel:
    """A function that numba compiles for the types of its first call, and keeps on disk.

    Kernels call each other like functions. What the compiler takes over from a module, constants
    and kernels, is looked up when it compiles.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.py_func = function
        update_wrapper(self, function)

    def __call__(self, *args: Any) -> Any:
        """Compile the function if need be, and call it; named arguments would make each slower."""
        return (self.interpreted if INTERPRETING.on else self.compiled)(*args)

    def __getattr__(self, name: str) -> Any:
        """Make `compiled`, numba's dispatcher, or `interpreted` when it is first asked for."""
        made: Any
        if name == "compiled":
            made = import_module("e3pose.base.dispatcher").dispatcher_of(self.py_func)
        elif name == "interpreted":
            made = FunctionType(
                self.py_func.__code__,
                {**self.py_func.__globals__, "math": _MATH},
                argdefs=self.py_func.__defaults__,
                closure=self.py_func.__closure__,
            )
        else:
            raise AttributeError(name)
        return self.__dict__.setdefault(name, made)  # the same for all threads

    def __reduce__(self) -> str:
        """Pickle by name."""
        return self.py_func.__qualname__

    @property
    def _numba_type_(self) -> Any:
        """Tell numba what a kernel that another one calls is."""
        return self.compiled._numba_type_


def kernel(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Declare a kernel, called by position: free of the interpreter lock, division as in numpy."""
    COMPILING.expect(function)
    return cast("Callable[Parameters, Result]", Kernel(function))


def is_cached(kernel: Any) -> bool | None:
    """Return whether a compiled form of a kernel is on disk; None where none can be kept."""
    return cast("bool | None", import_module("e3pose.base.dispatcher").is_kept(kernel.compiled))
