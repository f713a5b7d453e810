"""Options of a verb that set what a settings file may set: one for each field with a help text."""

from __future__ import annotations

import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, field, fields, make_dataclass
from types import NoneType
from typing import Annotated, Any, Literal, TypeVar

from cyclopts import Group, Parameter, Token

from e3pose.base.table import entries

T = TypeVar("T")


def whole_number(_: Any, tokens: Sequence[Token]) -> int:
    """Read a whole number and nothing that merely rounds to one."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"{tokens[0].value!r} is not a whole number") from None


Whole = Annotated[int, Parameter(converter=whole_number)]
Flag = Annotated[bool, Parameter(negative="")]  # an option without a --no- form


def options_from(
    kind: type, groups: Mapping[str, Group], defaults: bool = True
) -> Callable[[type[T]], type[T]]:
    """Return a decorator that makes a dataclass the options for the fields of settings.

    A field of the settings says with `entry` what its option is like: `help`; `group`, the title
    of those that it stands among; `flag`, one letter; `option`, its name where that is not its
    key; `shown`, its default as a person writes it; `negative`, whether it has a --no- form. A
    field that the dataclass declares itself keeps its type and its default.

    Args:
        kind: the settings.
        groups: by title.
        defaults: whether options have the defaults of the settings, or none at all.
    """

    def make(options: type[T]) -> type[T]:
        own = {item.name: item for item in fields(options)}  # type: ignore[arg-type]
        types = typing.get_type_hints(options, include_extras=True)
        made: list[tuple[str, Any, Any]] = []
        for item, known in zip(_read(kind), entries(kind), strict=True):
            said = item.metadata
            if "help" not in said:
                continue
            name = said.get("option", known.key)
            default = said.get("shown", None if item.default is MISSING else item.default)
            if name in own:
                asked, default = types[name], own[name].default
            else:
                default = default if defaults else None
                asked = _type(known.kind, default, said)
            text = " ".join(said["help"].split())
            option: Any = Annotated[asked, Parameter(help=text, alias=said.get("flag"))]
            if "group" in said:
                option = Annotated[option, Parameter(group=groups[said["group"]])]
            made.append((name, option, field(default=default)))
        found = make_dataclass(options.__name__, made, bases=(options,), frozen=True, kw_only=True)
        found.__module__, found.__doc__ = options.__module__, options.__doc__
        return Parameter(name="*")(found)

    return make


def _read(kind: Any) -> list[Any]:
    return [item for item in fields(kind) if item.init and item.metadata.get("key") != ""]


def _type(kind: Any, default: Any, said: Mapping[str, Any]) -> Any:
    """Return the type of an option, None included where that is the default."""
    kinds = [each for each in typing.get_args(kind) if each is not NoneType]
    plain = kind if typing.get_origin(kind) is Literal or not kinds else kinds[0]
    if "shown" in said:
        plain = type(said["shown"])
    whole = plain is int or (
        typing.get_origin(plain) is Literal and isinstance(typing.get_args(plain)[0], int)
    )
    if whole:
        plain = Whole
    elif plain is bool and not said.get("negative"):
        plain = Flag
    elif plain not in (bool, float) and (
        default is None or typing.get_origin(plain) is not Literal
    ):
        plain = str  # a wrong choice is then an error of the settings, which says where it stands
    return plain if default is not None else plain | None
