"""When a compiled kernel on disk may be used again.

numba asks a locator where a function is kept and for a stamp of its source, which is that of one
file. A kernel takes code and constants over from others, so its stamp is here of all modules that
its own one imports, directly or not.
"""

from __future__ import annotations

import hashlib
import pickle
import re
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.caching import CompileResultCacheImpl, FunctionCache

_PACKAGE = Path(__file__).resolve().parents[1]
_ROOM = Path(__file__).resolve().parent
_IMPORT = re.compile(r"^ *from (e3pose[\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
# How it is compiled; `base.kernel` imports them by name.
_COMPILER = (_ROOM / "dispatcher.py", Path(__file__).resolve())

# What reading a file raises that has types which this program does not know.
UNREADABLE = (pickle.UnpicklingError, AttributeError, ImportError, TypeError, EOFError)


@cache
def _imported(path: Path) -> tuple[Path, ...]:
    """Return the files of this package that a file imports names from."""
    return tuple(_files(path.read_text(encoding="utf-8")))


def _files(source: str) -> Iterator[Path]:
    for module, names in _IMPORT.findall(source):
        place = _PACKAGE.joinpath(*module.split(".")[1:])
        for found in (place, *(place / name for name in re.findall(r"\w+", names))):
            for path in (found.with_suffix(".py"), found / "__init__.py"):
                if path.is_file():
                    yield path


@cache
def sources_of(path: Path) -> tuple[Path, ...]:
    """Return the files that a kernel declared in `path` may take something over from."""
    found: set[Path] = set()
    left = [path, *_COMPILER]
    while left:
        path = left.pop()
        if path not in found:
            found.add(path)
            left += _imported(path)
    return tuple(sorted(found))


@cache
def stamp_of(path: Path) -> str:
    """Return a digest of everything that is compiled into the kernels of a file."""
    digest = hashlib.sha256()
    for source in sources_of(path):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def _stamped(locator: Any) -> Any:
    """Return a locator of numba that stamps a function with all its sources."""

    def get_source_stamp(self: Any) -> str:
        return stamp_of(Path(self._py_file).resolve())

    return type(locator.__name__, (locator,), {"get_source_stamp": get_source_stamp})


class _Results(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = tuple(map(_stamped, CompileResultCacheImpl._locator_classes))


class KernelCache(FunctionCache):  # type: ignore[misc]
    """Keeps compiled kernels where numba keeps functions, beside their source or for the user.

    Raises:
        RuntimeError: where nothing can be written.
    """

    _impl_class = _Results

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled form for a signature; None where there is none, or a stale one.

        numba looks at the stamp after it has loaded the types of the arguments, one of which an
        older version may have called differently.
        """
        try:
            return super().load_overload(sig, target_context)
        except UNREADABLE:
            self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled form where the disk takes it.

        Another program may have just kept what this one cannot read.
        """
        with suppress(*UNREADABLE, OSError):
            super().save_overload(sig, data)

    def is_filled(self) -> bool:
        """Return whether a compiled form for some signature is on disk, and not stale."""
        try:
            return bool(self._cache_file._load_index())
        except UNREADABLE:
            return False
