"""Arguments of compiled kernels that are taken apart once instead of in every call.

numba looks at every array of a tuple in every call: 0.3 us each, and a cache miss or two where a
program slept before. What stays the same from call to call is held in a structure of compiled code,
which a kernel gets as one pointer.
"""

from __future__ import annotations

from typing import Any, Generic, TypeVar, cast

from numba import types
from numba.experimental import structref

from e3pose.runtime.kernel import kernel

Values = TypeVar("Values")


@structref.register
class HeldType(types.StructRef):  # type: ignore[misc]
    """The type that numba gives to `Held`."""

    def preprocess_fields(self, fields: Any) -> Any:
        """Return the fields without literal types, which every value would have anew."""
        return tuple((name, types.unliteral(kind)) for name, kind in fields)


class Held(structref.StructRefProxy, Generic[Values]):  # type: ignore[misc]
    """A named tuple that compiled code holds; made by `hold`.

    Attributes:
        values: the tuple, for kernels only. Its arrays are those that were given, not copies.
    """

    values: Values


structref.define_proxy(Held, HeldType, ["values"])


def hold(values: Values) -> Held[Values]:
    """Return a named tuple of arrays and numbers in the form that kernels take at once."""
    return cast("Held[Values]", _hold(values))


@kernel
def _hold(values: Any) -> Any:
    return Held(values)
