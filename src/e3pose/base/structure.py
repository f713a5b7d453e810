"""How compiled code reads a `kernel_arguments.Held`; importing it imports the compiler.

A named tuple is laid out in words of 64 bits: a number takes one, an array its place in memory,
shape and strides, a named tuple in it those of its own fields. A kernel gets one pointer, and
so does each that it calls, where a tuple by value would be a thousand arguments to unpack and pack.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import typeof, types
from numba.core import cgutils
from numba.core.datamodel import models, register_default
from numba.core.typing.templates import AttributeTemplate
from numba.extending import NativeValue, infer_getattr, lower_getattr_generic, unbox
from numba.np.arrayobj import make_array, populate_array
from numpy.typing import NDArray

_WORD = ir.IntType(64)


class StructureType(types.Type):  # type: ignore[misc]
    """The type of a held named tuple.

    Attributes:
        fields: name to type and first word of each.
        words: of all.
    """

    def __init__(self, values: Any) -> None:
        self.fields: dict[str, tuple[Any, int]] = {}
        self.words = 0
        for name, value in zip(values._fields, values, strict=True):
            kind = StructureType(value) if hasattr(value, "_fields") else typeof(value)
            self.fields[name] = kind, self.words
            self.words += _words_of(kind)
        # Symbols have it many times, so that the name of all types would be most of the code.
        digest = hashlib.sha256(repr(self.fields).encode()).hexdigest()[:12]
        super().__init__(name=f"{type(values).__name__}_{digest}")


def _words_of(kind: Any) -> int:
    if isinstance(kind, StructureType):
        return kind.words
    return 1 + 2 * kind.ndim if isinstance(kind, types.Array) else 1


def words(values: Any) -> NDArray[np.int64]:
    """Return a named tuple as compiled code reads it; its arrays must outlive that."""
    return np.array(list(_words(values)), dtype=np.int64)


def _words(values: Any) -> Iterator[int]:
    for value in values:
        if hasattr(value, "_fields"):
            yield from _words(value)
        elif isinstance(value, np.ndarray):
            yield from (value.ctypes.data, *value.shape, *value.strides)
        elif isinstance(value, float):
            yield int(np.float64(value).view(np.int64))
        else:
            yield int(value)


register_default(StructureType)(models.OpaqueModel)


@infer_getattr
class _Fields(AttributeTemplate):  # type: ignore[misc]
    key = StructureType

    def generic_resolve(self, kind: StructureType, name: str) -> Any:
        """Return the type of a field; `values` of a held record is the record itself."""
        if name in kind.fields:
            return kind.fields[name][0]
        return kind if name == "values" else None


@lower_getattr_generic(StructureType)  # type: ignore[untyped-decorator]
def _field(context: Any, builder: Any, kind: StructureType, pointer: Any, name: str) -> Any:
    """Read a field. Arrays have no owner here: who calls the kernel holds them."""
    if name not in kind.fields:
        return pointer
    found, place = kind.fields[name]

    def word(offset: int) -> Any:
        at = cgutils.pointer_add(builder, pointer, 8 * (place + offset), _WORD.as_pointer())
        loaded = builder.load(at)
        # No kernel changes where an array is: it need not be read again after an array was written.
        loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
        return loaded

    if isinstance(found, StructureType):
        return cgutils.pointer_add(builder, pointer, 8 * place)
    if isinstance(found, types.Array):
        made, ndim = make_array(found)(context, builder), found.ndim
        populate_array(
            made,
            data=builder.inttoptr(word(0), made.data.type),
            shape=[word(1 + axis) for axis in range(ndim)],
            strides=[word(1 + ndim + axis) for axis in range(ndim)],
            itemsize=context.get_abi_sizeof(context.get_data_type(found.dtype)),
            meminfo=None,
        )
        return made._getvalue()
    value = context.get_value_type(found)
    if not isinstance(value, ir.IntType):
        return builder.bitcast(word(0), value)
    return word(0) if value.width == _WORD.width else builder.trunc(word(0), value)


@unbox(StructureType)  # type: ignore[untyped-decorator]
def _pointer(kind: StructureType, held: Any, c: Any) -> Any:
    address = c.pyapi.object_getattr_string(held, "address")
    pointer = c.pyapi.long_as_voidptr(address)
    c.pyapi.decref(address)
    return NativeValue(pointer)
