"""Kernels: functions that are compiled when they are first called.

Declaring one imports no compiler, so a law, its constants and its kernel stand in one file that
programs without a slot to compute may import: numba takes a second to import, and cameras and
`check` do without it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import update_wrapper
from importlib import import_module
from typing import Any, Generic, ParamSpec, TypeVar, cast

from e3pose.base.compiling import COMPILING

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

LANES = 16  # the innermost loops run over so many poses, which fills a vector register


class Kernel(Generic[Parameters, Result]):
    """A function that numba compiles for the types of its first call, and keeps on disk.

    Kernels call each other like functions. What the compiler takes over from a module, constants
    and kernels, is looked up when it compiles.
    """

    def __init__(self, function: Callable[Parameters, Result]) -> None:
        self.py_func = function
        update_wrapper(self, function)

    def __call__(self, *args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        """Compile the function if need be, and call it."""
        return cast(Result, self.compiled(*args, **kwargs))

    def __getattr__(self, name: str) -> Any:
        """Make `compiled`, numba's dispatcher, when it is first asked for."""
        if name != "compiled":
            raise AttributeError(name)
        made = import_module("e3pose.base.dispatcher").dispatcher_of(self.py_func)
        return self.__dict__.setdefault("compiled", made)  # the same for all threads

    @property
    def _numba_type_(self) -> Any:
        """Tell numba what a kernel that another one calls is."""
        return self.compiled._numba_type_


def kernel(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Declare a kernel: free of the interpreter lock, division as in numpy."""
    COMPILING.expect(function)
    return Kernel(function)


def is_cached(kernel: Any) -> bool | None:
    """Return whether a compiled form of a kernel is on disk; None where none can be kept."""
    return cast("bool | None", import_module("e3pose.base.dispatcher").is_kept(kernel.compiled))
