"""Arguments of compiled kernels that are taken apart once instead of in every call.

numba looks at every array of a tuple in every call: 0.3 us each, and a cache miss or two where a
program slept before; and each kernel that is called with it compiles the passing on of all. What
stays the same from call to call is held in one piece, which kernels get as one pointer.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, Generic, TypeVar

Values = TypeVar("Values")


class Held(Generic[Values]):
    """A named tuple of arrays, numbers and such tuples, in the form that kernels take at once.

    Attributes:
        values: the tuple. Its arrays are those that were given, not copies.
        address: of what compiled kernels read.
    """

    def __init__(self, values: Values) -> None:
        self.values = values

    def __getattr__(self, name: str) -> Any:
        """Make what compiled code reads when it is first asked for."""
        if name not in ("address", "_numba_type_"):
            raise AttributeError(name)
        structure = import_module("e3pose.base.structure")
        self._words = structure.words(self.values)
        self.address: int = self._words.ctypes.data
        self._numba_type_ = structure.StructureType(self.values)
        return self.__dict__[name]

    def __reduce__(self) -> tuple[type[Held[Values]], tuple[Values]]:
        """Pickle the tuple."""
        return Held, (self.values,)
