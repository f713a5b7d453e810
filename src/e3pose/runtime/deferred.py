"""Modules that are imported when something of them is first used.

Kernels need numba, which takes a second to import and which cameras do without, so that whoever
calls them cannot import them at once. An import in the function that calls costs 0.5 us in every
call, and several times that in a program that slept before; a slot has twenty.
"""

from __future__ import annotations

from importlib import import_module
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
