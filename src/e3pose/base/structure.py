"""The structure of compiled code behind `kernel_arguments`; importing it imports the compiler."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

from numba import types
from numba.experimental import structref

from e3pose.base.kernel import kernel

Values = TypeVar("Values")


@structref.register
class HeldType(types.StructRef):  # type: ignore[misc]
    """The type that numba gives to `Structure`."""

    def preprocess_fields(self, fields: Any) -> Any:
        """Return the fields without literal types, which every value would have anew."""
        return tuple((name, types.unliteral(kind)) for name, kind in fields)


class Structure(structref.StructRefProxy, Generic[Values]):  # type: ignore[misc]
    """A named tuple that compiled code holds; as `base.kernel_arguments.Held`.

    Attributes:
        values: the tuple, for kernels only. Its arrays are those that were given, not copies.
    """

    values: Values


structref.define_proxy(Structure, HeldType, ["values"])


@kernel
def structure_of(values: Any) -> Any:
    """Return a structure of a named tuple."""
    return Structure(values)
