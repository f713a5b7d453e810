"""Arguments of compiled kernels that are taken apart once instead of in every call.

numba looks at every array of a tuple in every call: 0.3 us each, and a cache miss or two where a
program slept before. What stays the same from call to call is held in a structure of compiled code,
which a kernel gets as one pointer.
"""

from __future__ import annotations

from importlib import import_module
from typing import Protocol, TypeVar, cast

Values = TypeVar("Values")


class Held(Protocol[Values]):
    """A named tuple that compiled code holds; made by `hold`.

    Attributes:
        values: the tuple, for kernels only. Its arrays are those that were given, not copies.
    """

    values: Values


def hold(values: Values) -> Held[Values]:
    """Return a named tuple of arrays and numbers in the form that kernels take at once."""
    made = import_module("e3pose.base.structure").structure_of(values)
    return cast("Held[Values]", made)
