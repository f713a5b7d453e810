"""How every kernel is compiled, and when a compiled kernel on disk may be used again."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba

from e3pose.runtime.compiling import COMPILING
from e3pose.runtime.dispatcher import KernelDispatcher

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

_PACKAGE = Path(__file__).resolve().parents[1]
FILTER = "e3pose.estimate.filter."  # how the names of the filter's kernels begin
LANES = 16  # the innermost loops run over so many poses, which fills a vector register
# What is compiled, and the modules whose constants it takes over.
SOURCES = (
    *sorted((_PACKAGE / "geometry").glob("*.py")),
    *sorted((_PACKAGE / "estimate" / "per_slot").glob("*.py")),
    _PACKAGE / "model" / "pose.py",
    Path(__file__).resolve(),
    Path(__file__).resolve().with_name("dispatcher.py"),
)
# The filter's kernels call the others, but not the other way round.
_FILTER = _PACKAGE / "estimate" / "filter"
FILTER_SOURCES = (
    *SOURCES,
    *sorted(_FILTER.rglob("*.py")),
    _PACKAGE / "model" / "proportions.py",
)
PREDICTOR = "e3pose.predict."
PREDICTOR_SOURCES = (*sorted((_PACKAGE / "predict" / "kernels").glob("*.py")), *SOURCES[-2:])
SELECTION = "e3pose.select."
SELECTION_SOURCES = (*sorted((_PACKAGE / "select" / "kernels").glob("*.py")), *FILTER_SOURCES)


def sources_stamp(sources: tuple[Path, ...] = SOURCES) -> str:
    """Return a digest of everything that is compiled into a kernel."""
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sources:
        digest.update(path.read_bytes() if path.exists() else b"")
    return digest.hexdigest()


@cache
def _stamp_of(module: str) -> str:
    """Return the digest for the kernels of a module."""
    for start, sources in (
        (FILTER, FILTER_SOURCES),
        (PREDICTOR, PREDICTOR_SOURCES),
        (SELECTION, SELECTION_SOURCES),
    ):
        if module.startswith(start):
            return sources_stamp(sources)
    return sources_stamp()


def _or_nothing(load_index: Callable[[], dict[Any, str]]) -> Callable[[], dict[Any, str]]:
    """Take what is on disk as stale where it cannot be read.

    numba looks at the stamp only after it has loaded the types of the arguments, one of which an
    older version may have called differently.
    """

    def load() -> dict[Any, str]:
        try:
            return load_index()
        except (pickle.UnpicklingError, AttributeError, ImportError, TypeError, EOFError):
            return {}

    return load


def kernel(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Compile a function: cached on disk, free of the interpreter lock, division as in numpy.

    Of the fast-math flags only `contract` is safe: it fuses a product and a sum, with one rounding
    where the reference has two. Reordering or ignoring NaN would break the agreement.
    """
    options: dict[str, Any] = {
        "nogil": True,
        "error_model": "numpy",
        "fastmath": {"contract"},
    }
    COMPILING.expect(function)
    try:
        dispatcher: Any = KernelDispatcher(function, targetoptions={**options, "nopython": True})
        dispatcher.enable_caching()
        cache_file = dispatcher._cache._cache_file
        # numba asks only whether the file of the outermost function changed. A kernel that was
        # inlined from another file would stay as it was, and disagree with its caller about the
        # layout of memory.
        if not hasattr(cache_file, "_source_stamp"):
            raise AttributeError("numba keeps its stamp elsewhere")
        cache_file._source_stamp = _stamp_of(function.__module__)
        cache_file._load_index = _or_nothing(cache_file._load_index)
    except (RuntimeError, AttributeError):  # nowhere to write, or another numba: compile each time
        dispatcher = numba.njit(**options)(function)
    return cast(Callable[Parameters, Result], dispatcher)


def is_cached(kernel: Any) -> bool | None:
    """Return whether a compiled form of a kernel is on disk; None where none can be kept."""
    try:
        return bool(kernel._cache._cache_file._load_index())
    except AttributeError:
        return None
