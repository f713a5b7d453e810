"""Files and functions stay short enough to be read: lengths that only go down."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import e3pose

SOURCE = Path(e3pose.__file__).parent
MOST_LINES = 400  # of a file
MOST_FUNCTION_LINES = 80  # with signature and docstring


@cache
def lengths() -> dict[str, int]:
    """Return the lines of every function, by its file and name."""
    return {
        f"{path.relative_to(SOURCE).as_posix()} {node.name}": (
            (node.end_lineno or 0) - node.lineno + 1
        )
        for path in SOURCE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
    }


def test_functions_are_short() -> None:
    found = lengths()
    assert len(found) > 1000
    long = {name: n for name, n in found.items() if n > MOST_FUNCTION_LINES}
    assert long == {}


def test_files_are_short() -> None:
    found = {
        path.relative_to(SOURCE).as_posix(): len(path.read_text().splitlines())
        for path in SOURCE.rglob("*.py")
    }
    long = {name: n for name, n in found.items() if n > MOST_LINES}
    assert long == {}
