"""Modules that are imported when something of them is first used.

Kernels need numba, which takes a second to import and which cameras do without, so that whoever
calls them cannot import them at once. An import in the function that calls costs 0.5 us in every
call, and several times that in a program that slept before; a slot has twenty.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Any


class Deferred:
    """A module by its name; its attributes are those of the module.

    For type checkers, import the module itself:

        if TYPE_CHECKING:
            from e3pose.select.kernels import boxes
        else:
            boxes = Deferred("e3pose.select.kernels.boxes")
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        found = getattr(import_module(self._name), attribute)
        setattr(self, attribute, found)  # the next look finds it without this function
        return found


def require_module(name: str) -> None:
    """Raise `ModuleNotFoundError` for a module that is not installed, without importing it.

    Verbs ask before the work whose result the module would draw.
    """
    if find_spec(name) is None:
        raise ModuleNotFoundError(f"no module {name}", name=name)


def names_of(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the `__getattr__` of a package whose names are imported when they are first used.

    Args:
        package: its name.
        homes: each name and the module below the package that has it.
    """

    def find(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{homes[name]}"), name)

    return find
