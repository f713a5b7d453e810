"""Read a TOML table into a typed record; unknown keys and wrong values are errors."""

from __future__ import annotations

import dataclasses
import inspect
import math
import sys
import types
import typing
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, TypeVar, Union

import msgspec

from e3pose.base.bounded import read_toml
from e3pose.base.errors import MISSING, InputError
from e3pose.base.quantities import check_within

T = TypeVar("T")

FIRST = ("format", "version")  # say which keys a file may have
MAX_SHOWN = 80
NAMES = {
    str: "text",
    Path: "text",
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    dict: "a table",
    list: "a list",
    tuple: "a list",
    type(None): "nothing",
}
FOUND = {**NAMES, bool: "a boolean"}


def entry(
    default: Any = dataclasses.MISSING,
    *,
    key: str | None = None,
    read: Callable[[Any], Any] | None = None,
    write: str = "",
    **option: Any,
) -> Any:
    """Declare a field of a record that is read from a table, where its type does not say it all.

    Args:
        default: without the key.
        key: its name in the table; the field's own by default, and none at all if empty.
        read: from what is written to the value; it may raise `InputError` without a thing.
        write: an example to tell whoever left the key out.
        option: where a command line may set it too: its `help`, and what else is not usual there,
            see `cli.settings_options`.
    """
    said = {"key": key, "read": read, "write": write, **option}
    return dataclasses.field(default=default, metadata=said)


@dataclasses.dataclass(frozen=True, slots=True)
class Entry:
    """The declaration of one field of a record."""

    field: str
    key: str
    kind: Any
    required: bool
    read: Callable[[Any], Any] | None = None
    write: str = ""


@lru_cache(maxsize=256)
def entries(kind: Any) -> tuple[Entry, ...]:
    """Return the entries of a kind of table: a dataclass or a msgspec struct."""
    if not dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        return tuple(
            Entry(item.name, item.encode_name, hints[item.name], item.required)
            for item in msgspec.structs.fields(kind)
        )
    found, hints = [], _hints(kind)
    for item in dataclasses.fields(kind):
        key = item.metadata.get("key")
        if item.init and key != "":
            missing = item.default is item.default_factory is dataclasses.MISSING
            read, write = item.metadata.get("read"), item.metadata.get("write", "")
            hint = str if read else hints[item.name]
            found.append(Entry(item.name, key or item.name, hint, missing, read, write))
    return tuple(found)


@lru_cache(maxsize=256)
def _bounds(kind: Any) -> tuple[tuple[str, str, float, float], ...]:
    """Return field, key, least and most of each field whose type has bounds; inf for no most."""
    keys = {item.field: item.key for item in entries(kind)}
    found = []
    for name, hint in _hints(kind, include_extras=True).items():
        for each in (hint, *typing.get_args(hint)):
            for meta in getattr(each, "__metadata__", ()):
                if isinstance(meta, msgspec.Meta) and meta.ge is not None:
                    found.append(
                        (name, keys[name], meta.ge, math.inf if meta.le is None else meta.le)
                    )
    return tuple(found)


def check_bounds(record: object) -> None:
    """Raise `InputError` for a number outside the bounds that its type has; its thing is the key.

    A bounded field is `Annotated[float, msgspec.Meta(ge=..., le=...)]`, as in messages; without
    `le` it may be any finite number from `ge` on. A dataclass calls this when it is made.
    """
    kind: Any = type(record)
    for name, key, low, high in _bounds(kind):
        if isinstance(value := getattr(record, name), int | float):
            check_within(key, value, low, high)


def _hints(kind: Any, include_extras: bool = False) -> dict[str, Any]:
    """Return the types of the fields that a table sets: those of others may not be loaded."""
    plain = {
        item.name
        for item in dataclasses.fields(kind)
        if item.metadata.get("key") != "" and not item.metadata.get("read")
    }
    hints: dict[str, Any] = {}
    for base in reversed(kind.__mro__):
        own = inspect.get_annotations(base)
        read = types.SimpleNamespace(__annotations__={n: own[n] for n in own if n in plain})
        scope = vars(sys.modules[base.__module__])
        hints |= typing.get_type_hints(read, scope, include_extras=include_extras)
    return hints


def read_table(kind: type[T], table: object) -> T:
    """Return the record that a table describes.

    Args:
        kind: a dataclass, whose fields may be declared with `entry`, or a msgspec struct.
        table: as parsed; keys may be written with `-` for `_`.

    Raises:
        InputError: for a key that is unknown, missing or written twice, and for a value of another
            type; its thing is the key.
    """
    if not isinstance(table, Mapping):
        raise InputError("", _named(table), "a table")
    plain = {str(key).replace("-", "_"): value for key, value in table.items()}
    listed_kind: Any = kind
    known = {item.key: item for item in entries(listed_kind)}
    for key in FIRST:
        if key in plain and key in known:  # another kind or version has other keys
            _value_of(known[key], plain[key])
    for key in plain:
        if key not in known:
            listed = f"one of {', '.join(known)}"
            raise InputError("", f"unknown key {key[:MAX_SHOWN]!r}", listed)
    if len(plain) < len(table):
        raise InputError("", "a key twice, once with - and once with _")
    values = {}
    for key, item in known.items():
        if key in plain:
            values[item.field] = _value_of(item, plain[key])
        elif item.required:
            raise InputError("", MISSING, f"{key} = {item.write or _example(item.kind)}")
    return kind(**values)


def read_file(kind: type[T], path: Path, limit_bytes: int) -> T:
    """Return the record that a TOML file of at most `limit_bytes` describes.

    Raises:
        InputError: naming the file, and the key as `read_table` does.
    """
    table = read_toml(path, limit_bytes)
    try:
        return read_table(kind, table)
    except InputError as error:
        raise error.at(path) from None


def _value_of(item: Entry, found: Any) -> Any:
    try:
        return convert(item.kind, found) if item.read is None else item.read(found)
    except InputError as error:
        raise error.under(item.key) from None


def convert(kind: Any, found: Any) -> Any:
    """Return a value as a type hint asks for; raise `InputError` for one of another type."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if kind is Any or kind is object:
        return found
    if origin is Literal:
        if any(found == value and type(found) is type(value) for value in inner):
            return found
    elif origin in (Union, types.UnionType):
        return _one_of(inner, found)
    elif origin in (tuple, list) and isinstance(found, list | tuple):
        return (tuple if origin is tuple else list)(_listed(origin, inner, found))
    elif origin is not None and issubclass(origin, Mapping) and isinstance(found, Mapping):
        return {
            _inside(inner[0], str(key), key): _inside(inner[1], value, key)
            for key, value in found.items()
        }
    elif dataclasses.is_dataclass(kind) or (_is_class(kind) and issubclass(kind, msgspec.Struct)):
        return found if isinstance(found, kind) else read_table(kind, found)
    elif kind is float and isinstance(found, int | float) and not isinstance(found, bool):
        return float(found)
    elif kind is Path and isinstance(found, str):
        return Path(found)
    elif _is_a(kind, found):
        return found
    raise InputError("", _shown(kind, found), _expected(kind))


def _one_of(kinds: tuple[Any, ...], found: Any) -> Any:
    deeper: InputError | None = None
    for kind in kinds:
        try:
            return convert(kind, found)
        except InputError as error:
            if error.thing:  # inside a table, and so nearer to what was meant
                deeper = error
    named = [_expected(kind) for kind in kinds if kind is not type(None)]
    raise deeper or InputError("", _shown(kinds, found), " or ".join(named))


def _listed(origin: Any, inner: tuple[Any, ...], found: Any) -> list[Any]:
    if origin is tuple and inner[-1] is not ...:
        if len(inner) != len(found):
            raise InputError("", f"{len(found)} values", str(len(inner)))
        kinds = inner
    else:
        kinds = inner[:1] * len(found)
    return [_inside(kind, one, i) for i, (kind, one) in enumerate(zip(kinds, found, strict=True))]


def _inside(kind: Any, found: Any, where: object) -> Any:
    try:
        return convert(kind, found)
    except InputError as error:
        raise error.under(f"[{str(where)[:MAX_SHOWN]}]") from None


def _is_a(kind: Any, found: Any) -> bool:
    """Return whether a value is of a plain type, where true is no number."""
    fits = _is_class(kind) and isinstance(found, kind)
    return fits and (kind is bool or not isinstance(found, bool))


def _is_class(kind: Any) -> bool:
    """Return whether a type hint is a class, which Python 3.10 also says of `list[int]`."""
    return isinstance(kind, type) and typing.get_origin(kind) is None


def _expected(kind: Any) -> str:
    if typing.get_origin(kind) is Literal:
        return " or ".join(repr(value) for value in typing.get_args(kind))
    origin = typing.get_origin(kind) or kind
    if origin in NAMES:
        return NAMES[origin]
    return "a table"


def _shown(kind: Any, found: Any) -> str:
    """Return a value itself where it is one of the wrong choice, else what sort of thing it is."""
    kinds: tuple[Any, ...] = kind if isinstance(kind, tuple) else (kind,)
    literals = [each for each in kinds if typing.get_origin(each) is Literal]
    chosen = [value for each in literals for value in typing.get_args(each)]
    if any(type(value) is type(found) for value in chosen):
        return repr(found)[:MAX_SHOWN]
    return _named(found)


def _named(found: Any) -> str:
    return FOUND.get(type(found), type(found).__name__)


def _example(kind: Any) -> str:
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is Literal:
        return f'"{inner[0]}"' if isinstance(inner[0], str) else str(inner[0])
    return {str: '"..."', Path: '"..."', int: "1", float: "1.0", bool: "true"}.get(kind, "...")
