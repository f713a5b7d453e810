"""What does not fit a table is told with its place, in words that need no Python."""

from __future__ import annotations

from typing import Any, Literal

import msgspec
import pytest

from e3pose.files.misfit import misfit


class Inner(msgspec.Struct, forbid_unknown_fields=True):
    size: float
    mode: Literal["on", "off"] | None = None


class Outer(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    lead: int | Literal["adaptive"] = 1
    parts: tuple[Inner, ...] = ()
    by_name: dict[str, Inner] = {}


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ({}, "name: not found, expected it"),
        ({"name": 3}, "name: found a whole number, expected text"),
        ({"name": True}, "name: found a boolean, expected text"),
        ({"name": "a", "x": 1}, "unknown key 'x', expected one of name, lead, parts, by_name"),
        ({"name": "a", "lead": "b"}, "lead: found 'b', expected 'adaptive' or a whole number"),
        ({"name": "a", "parts": {}}, "parts: found a table, expected a list"),
        ({"name": "a", "parts": [{}]}, "parts[0].size: not found, expected it"),
        (
            {"name": "a", "parts": [{"size": 1, "x": 2}]},
            "parts[0]: unknown key 'x', expected one of size, mode",
        ),
        (
            {"name": "a", "parts": [{"size": 1}, {"size": 1, "mode": "up"}]},
            "parts[1].mode: found 'up', expected 'off' or 'on'",
        ),
        (
            {"name": "a", "by_name": {"b": {"size": "c"}}},
            "by_name[...].size: found text, expected a number",
        ),
    ],
)
def test_what_is_wrong_is_told_in_words(table: dict[str, Any], told: str) -> None:
    with pytest.raises(msgspec.ValidationError) as caught:
        msgspec.convert(table, Outer)
    assert misfit(caught.value, Outer) == told
