"""Numbers of messages with their bounds, which hold on arrival; NaN is outside all of them."""

from __future__ import annotations

import re
from typing import Annotated, Any

import msgspec
from msgspec import Meta, inspect

from e3pose.model.camera_fields import check_camera_id

MAX_SLOT = 2**53
MAX_TIME_NS = 2**62
MAX_FIGURE = 1e15  # of a status: watts, milliseconds, millimetres; clocks that were set go far

Slot = Annotated[int, Meta(ge=0, le=MAX_SLOT)]
Session = Slot
TimeNs = Annotated[int, Meta(ge=0, le=MAX_TIME_NS)]
OffsetNs = Annotated[int, Meta(ge=-MAX_TIME_NS, le=MAX_TIME_NS)]
Count = Annotated[int, Meta(ge=0, le=MAX_TIME_NS)]
Share = Annotated[float, Meta(ge=0, le=1)]
Amount = Annotated[float, Meta(ge=0, le=1e12)]  # of a camera: joules, watts, seconds
Figure = Annotated[float, Meta(ge=0, le=MAX_FIGURE)]
SignedFigure = Annotated[float, Meta(ge=-MAX_FIGURE, le=MAX_FIGURE)]
TemperatureC = Annotated[float, Meta(ge=-273.15, le=1000)]

_PLACE = r"\[([^\]]*)\]|\.(\w+)"  # in an array; in a map
_OUTSIDE = re.compile(rf"Expected `(?:int|float)` [<>]=? \S+ - at `\$((?:{_PLACE})+)`")


def out_of_bounds(error: msgspec.ValidationError, body: bytes, kinds: tuple[Any, ...]) -> str:
    """Return the field of a message that is out of bounds, its value and the expected range.

    Args:
        error: what decoding said; it has places in place of names.
        body: the message.
        kinds: of messages, each with a tag.

    Returns:
        One line; empty where something else is wrong.

    Raises:
        InputError: for the id of a camera that cannot be one.
    """
    outside = _OUTSIDE.match(str(error))
    if outside is None:
        return ""
    try:
        found: Any = msgspec.msgpack.decode(body)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return ""  # what comes after the number is no message
    (kind,) = (each for each in kinds if each.__struct_config__.tag == found[0])
    typed: Any = inspect.type_info(kind)
    where, name = [kind.__name__.lower()], ""
    for place, key in re.findall(_PLACE, outside[1]):
        typed = _plain(typed)
        if isinstance(typed, inspect.DictType):
            typed = typed.value_type
            ge, le = typed.ge, typed.le
            found = next(value for value in found.values() if not ge <= value <= le)
            continue
        if key:
            name, found = key, found[key]
            (typed,) = (item.type for item in typed.fields if item.name == key)
            continue
        if isinstance(typed, inspect.StructType):
            item = typed.fields[int(place) - (typed.tag is not None)]
            typed, name = item.type, item.name
        else:
            typed = getattr(typed, "item_type", None) or typed.item_types[int(place)]
        found = found[int(place)]
        if isinstance(found, dict) and "camera_id" in found:
            where.append(f"camera {check_camera_id(found['camera_id'])}")
    number = _plain(typed)
    whole = isinstance(number, inspect.IntType)
    low, high = (str(end) if whole else f"{end:g}" for end in (number.ge, number.le))
    return f"{': '.join(where)}: {name}: found {found}, expected {low} to {high}"


def _plain(typed: Any) -> Any:
    """Return a type without None."""
    if not isinstance(typed, inspect.UnionType):
        return typed
    return next(each for each in typed.types if not isinstance(each, inspect.NoneType))
