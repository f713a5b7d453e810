"""Say in plain words, with the place first, what does not fit where a table is read."""

from __future__ import annotations

import re
from typing import Any

import msgspec

WORDS = {
    "str": "text",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "object": "a table",
    "array": "a list",
}
TYPE = re.compile(r"Expected `(.+?)`, got `(.+?)`")
CHOICE = re.compile(r"Invalid enum value (.+)", re.DOTALL)
UNKNOWN = re.compile(r"Object contains unknown field `(.*)`", re.DOTALL)
MISSING = re.compile(r"Object missing required field `(.+)`")
MAX_SHOWN = 80


def misfit(error: msgspec.ValidationError, kind: Any) -> str:
    """Return one line, `field: found X, expected Y`, for what msgspec says of a table.

    Args:
        error: as raised by `msgspec.convert`.
        kind: the type that the table was to be.
    """
    what, _, place = str(error).rpartition(" - at ")
    if not what:
        what, place = place, ""
    where = place.strip("`").removeprefix("$").lstrip(".")
    if match := MISSING.fullmatch(what):
        return f"{f'{where}.' if where else ''}{match[1]}: not found, expected it"
    return f"{where}: {_said(what, where, kind)}" if where else _said(what, where, kind)


def _said(what: str, where: str, kind: Any) -> str:
    if match := UNKNOWN.fullmatch(what):
        known = ", ".join(field.name for field in getattr(_at(kind, where), "fields", ()))
        return f"unknown key {match[1][:MAX_SHOWN]!r}" + (known and f", expected one of {known}")
    if match := CHOICE.fullmatch(what):
        known = " or ".join(_choices(_at(kind, where)))
        return f"found {match[1][:MAX_SHOWN]}" + (known and f", expected {known}")
    if match := TYPE.fullmatch(what):
        expected = " or ".join(WORDS[word] for word in match[1].split(" | ") if word in WORDS)
        found = "a boolean" if match[2] == "bool" else WORDS.get(match[2], match[2])
        return f"found {found}, expected {expected or match[1]}"
    return what[:1].lower() + what[1:]


def _at(kind: Any, where: str) -> Any:
    """Return what msgspec knows of the type at a place such as `camera[0].idle_mode`."""
    found: Any = msgspec.inspect.type_info(kind)
    for part in [part for part in re.split(r"[.\[]", where) if part]:
        found = next((t for t in getattr(found, "types", ()) if hasattr(t, "fields")), found)
        if part.endswith("]"):
            found = getattr(found, "item_type", getattr(found, "value_type", None))
        else:
            fields = getattr(found, "fields", ())
            found = next((field.type for field in fields if field.name == part), None)
    return next((t for t in getattr(found, "types", ()) if hasattr(t, "fields")), found)


def _choices(found: Any) -> list[str]:
    inner = getattr(found, "types", (found,))
    values = [repr(value) for one in inner for value in getattr(one, "values", ())]
    return values + ["a whole number"] * any(isinstance(i, msgspec.inspect.IntType) for i in inner)
