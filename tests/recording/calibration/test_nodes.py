"""YAML of calibrations: how deep its values may be nested."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.recording.calibration.nodes import MAX_DEPTH, parse

PATH = Path("rig.yml")
# Each way of nesting, once more than is allowed: what opens, and what closes.
NESTINGS = {
    "lists in brackets": ("[\n", "]\n"),
    "tables in braces": ("{a:\n", "}\n"),
    "lists of dashes": ("- ", ""),
    "keys that are tables": ("? ", ""),
}


@each_case("nesting", NESTINGS)
def test_values_nested_too_deep_are_refused(nesting: str) -> None:
    opens, closes = NESTINGS[nesting]
    depth = MAX_DEPTH + 1
    with pytest.raises(InputError, match=rf"^rig.yml: line \d+: .*at most {MAX_DEPTH} levels$"):
        parse(PATH, "a:\n  " + opens * depth + "x " + closes * depth)


def test_values_nested_as_in_calibrations_are_read() -> None:
    assert parse(PATH, "a: [[{b: [[c], [d]]}]]") == {"a": [[{"b": [["c"], ["d"]]}]]}


def test_reading_ends_where_values_are_nested_too_deep() -> None:
    with pytest.raises(InputError, match=f"line {MAX_DEPTH}:"):
        parse(PATH, "a: " + "[\n" * 50_000)
