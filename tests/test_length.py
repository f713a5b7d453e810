"""The whole stays small enough to be read, and each function: numbers that only go down."""

from __future__ import annotations

import ast
from functools import cache

import pytest
from tests.distributions import PACKAGES, ROOT, read
from tests.house import PARTS, lines, measure

FILES = [
    (f"{package}/{path.relative_to(folder).as_posix()}", path.read_text())
    for package, folder in PACKAGES.items()
    for path in folder.rglob("*.py")
]
BOUNDS: dict[str, dict[str, int]] = read(ROOT, "house.toml")
MOST_FUNCTION_LINES = 76  # with its signature, without its docstring: verbs have long help


def lines_of_docstring(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    said = node.body[0]
    known = ast.get_docstring(node, clean=False) is not None
    return (said.end_lineno or 0) - said.lineno + 1 if known else 0


@cache
def lengths() -> dict[str, int]:
    """Return the lines of every function but for its docstring, by its file and name."""
    return {
        f"{name} {node.name}": (node.end_lineno or 0) - node.lineno + 1 - lines_of_docstring(node)
        for name, text in FILES
        for node in ast.walk(ast.parse(text))
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
    }


def test_functions_are_short() -> None:
    found = lengths()
    assert len(found) > 1000
    long = {name: n for name, n in found.items() if n > MOST_FUNCTION_LINES}
    assert long == {}


@pytest.mark.parametrize("part", BOUNDS)
def test_the_house_keeps_to_its_bounds(part: str) -> None:
    bounds = BOUNDS[part]
    found = {"lines": lines(ROOT / part)} if list(bounds) == ["lines"] else measure(ROOT / part)
    over = {
        key: f"{found[key]}, at most {most}" for key, most in bounds.items() if found[key] > most
    }
    assert over == {}, "remove as much as you add, see CONTRIBUTING.md"


def test_every_part_of_the_house_has_a_bound() -> None:
    assert BOUNDS.keys() == set(PARTS)


MOST_LINES_OF_PAGES = 4_010  # script, styles and markup of our own, all pages together


def test_pages_stay_plain() -> None:
    files = [
        path
        for root in PACKAGES.values()
        for kind in ("js", "css", "html")
        for path in root.rglob(f"*.{kind}")
        if "vendor" not in path.parts
    ]
    assert len(files) > 40
    lines = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files)
    assert lines <= MOST_LINES_OF_PAGES, lines
