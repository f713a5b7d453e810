"""What does not fit a table is reported with its key, in plain words."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import pytest
from msgspec import Meta
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.base.quantities import length_m
from e3pose.base.table import check_bounds, entry, read_file, read_table


class Inner(msgspec.Struct):
    size: float
    mode: Literal["on", "off"] | None = None


@dataclass(frozen=True)
class Outer:
    name: str = entry(write='"a name"')
    lead: int | Literal["adaptive"] = 1
    parts: tuple[Inner, ...] = ()
    by_name: Mapping[str, Inner] | None = None
    apart_m: float | None = entry(None, key="apart", read=length_m)
    hidden: object = entry(None, key="")


KEYS = "name, lead, parts, by_name, apart"


@each_case(
    ("table", "message"),
    [
        ({}, 'missing: name = "a name"'),
        ([], "found a list, expected a table"),
        ({"name": 3}, "name: found a whole number, expected text"),
        ({"name": True}, "name: found a boolean, expected text"),
        ({"name": "a", "x": 1}, f"found unknown key 'x', expected one of {KEYS}"),
        ({"name": "a", "hidden": 1}, f"found unknown key 'hidden', expected one of {KEYS}"),
        ({"name": "a", "by-name": {}, "by_name": {}}, "found a key twice, once with - and"),
        ({"name": "a", "lead": "b"}, "lead: found 'b', expected a whole number or 'adaptive'"),
        ({"name": "a", "lead": True}, "lead: found a boolean, expected a whole number or 'adapt"),
        ({"name": "a", "parts": {}}, "parts: found a table, expected a list"),
        ({"name": "a", "parts": [{}]}, "parts[0]: missing: size = 1.0"),
        (
            {"name": "a", "parts": [{"size": 1, "x": 2}]},
            "parts[0]: found unknown key 'x', expected one of size, mode",
        ),
        (
            {"name": "a", "parts": [{"size": 1}, {"size": 1, "mode": "up"}]},
            "parts[1].mode: found 'up', expected 'on' or 'off'",
        ),
        (
            {"name": "a", "by_name": {"b": {"size": "c"}}},
            "by_name[b].size: found text, expected a number",
        ),
        ({"name": "a", "apart": 3}, "apart: found 3, expected a number and mm, cm, m"),
        ({"name": "a", "apart": "3"}, "apart: found '3', expected a number and mm, cm, m"),
    ],
)
def test_what_is_wrong_is_reported_in_words(table: Any, message: str) -> None:
    with pytest.raises(InputError) as caught:
        read_table(Outer, table)
    assert str(caught.value).startswith(message)


def test_what_fits_is_read() -> None:
    table = {"name": "a", "lead": "adaptive", "parts": [{"size": 1}], "apart": "4cm"}
    read = read_table(Outer, table)
    assert read == Outer("a", "adaptive", (Inner(1.0),), None, 0.04)


@each_case(
    ("text", "message"),
    [
        ("size = 'x'", "size: found text, expected a number"),
        ("size =", "found text that is not TOML: "),
        ("size = 1.0 # " + "x" * 100, "found 113 bytes, expected at most 100"),
    ],
)
def test_a_file_is_named_once(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "inner.toml"
    path.write_text("size = 2")
    assert read_file(Inner, path, 100) == Inner(2.0)
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_file(Inner, path, 100)
    assert str(caught.value).startswith(f"{path}: {message}")


def test_an_error_is_reported_where_it_was_written() -> None:
    error = InputError("cameras", 99, "at most 4")
    assert (error.thing, error.found, error.expected) == ("cameras", "99", "at most 4")
    there = error.under("loop").at("site.toml")
    assert str(there) == "site.toml: loop.cameras: found 99, expected at most 4"
    assert str(there.at("other.toml")) == str(there), "who found it knows best"
    assert str(error.at(thing="--cameras")) == "--cameras: found 99, expected at most 4"
    assert str(InputError("all in one").at("a.toml")) == "a.toml: all in one"
    assert str(pickle.loads(pickle.dumps(there))) == str(there)


@dataclass(frozen=True)
class Bounded:
    rate_hz: Annotated[float, Meta(ge=0.5, le=100)] = entry(1.0, key="rate")
    count: Annotated[int, Meta(ge=1, le=60)] | Literal["all"] | None = None

    def __post_init__(self) -> None:
        check_bounds(self)


@each_case(
    ("table", "message"),
    [
        ({"rate": 0.1}, "rate: found 0.1, expected 0.5 to 100"),
        ({"rate": float("nan")}, "rate: found nan, expected 0.5 to 100"),
        ({"count": 61}, "count: found 61, expected 1 to 60"),
    ],
)
def test_number_out_of_its_bounds_is_named_by_its_key(table: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as error:
        read_table(Bounded, table)
    assert str(error.value) == message


@each_case("count", [1, 60, "all", None])
def test_bounds_are_of_numbers_alone(count: Any) -> None:
    assert Bounded(100, count).count == count
