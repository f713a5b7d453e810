"""How large the house is, and how fine its grain: what `house.toml` bounds.

    python -m tests.house [--rooms]

prints each part of the house, and with `--rooms` the code of each package of the product.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path

from tests.distributions import ROOT, nodes

PARTS = ("src/e3pose", "hub", "lab", "tests")
MARK = re.compile(r"# tuned:(?:[^\n]*\n\s*#)*[^\n]*")  # of a number that was tuned
NAME = re.compile(r"[\w.:]+")  # a string that may name a function, as in a table
NOT_MEASURED = re.compile(r"not\s+(?:#\s*)?measured")


def texts(root: Path) -> dict[Path, str]:
    """Return the text of each Python file below a folder."""
    paths = (path for path in sorted(root.rglob("*.py")) if "__pycache__" not in path.parts)
    return {path: path.read_text() for path in paths}


def lines(root: Path) -> int:
    """Return the lines of all Python files below a folder."""
    return sum(text.count("\n") for text in texts(root).values())


def measure(root: Path) -> dict[str, int]:
    """Return what `house.toml` bounds, by its key there, of all Python files below a folder."""
    used: Counter[str] = Counter()
    importers: dict[str, set[Path]] = defaultdict(set)
    functions: list[ast.FunctionDef | ast.AsyncFunctionDef] = []
    people = code = 0
    files = texts(root)
    for path, text in files.items():
        code += _code_lines(text, nodes(path))
        for node in nodes(path):
            if isinstance(node, ast.Name):
                used[node.id] += 1
            elif isinstance(node, ast.Attribute):
                used[node.attr] += 1
            elif isinstance(node, ast.Constant):
                if isinstance(node.value, str) and NAME.fullmatch(node.value):
                    used[re.split("[.:]", node.value)[-1]] += 1
            elif isinstance(node, (ast.Import, ast.ImportFrom)):
                for name in _imported(node):
                    importers[name].add(path)
            elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                functions.append(node)
            elif isinstance(node, ast.ClassDef):
                people += _holds_people(node)
    named = Counter(one.name for one in functions)
    plain = [one.name for one in functions if not one.decorator_list]
    paths = [path for path in files if path.name != "__init__.py"]
    modules = [".".join(path.relative_to(root.parent).with_suffix("").parts) for path in paths]
    marks = MARK.findall("\n".join(files.values()))
    return {
        "lines": lines(root),
        "code": code,  # without docstrings, comments and blank lines
        "used_once": sum(used[name] == 1 and named[name] == 1 for name in plain),
        "one_importer": sum(len(importers[name]) == 1 for name in modules),
        "whole_people": people,  # classes that hold tracks or joints
        "tuned": len(marks),
        "not_measured": sum(bool(NOT_MEASURED.search(mark)) for mark in marks),
    }


def _code_lines(text: str, found: Sequence[ast.AST]) -> int:
    lines = (line.strip() for line in text.split("\n"))
    code = {number for number, line in enumerate(lines, 1) if line and line[0] != "#"}
    for node in found:
        if isinstance(node, (ast.Constant, ast.JoinedStr)):  # may have lines that look empty
            code.update(range(node.lineno, (node.end_lineno or 0) + 1))
    for node in found:
        if not isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        if ast.get_docstring(node, clean=False) is not None:
            said = node.body[0]
            code.difference_update(range(said.lineno, (said.end_lineno or 0) + 1))
    return len(code)


def _imported(node: ast.Import | ast.ImportFrom) -> list[str]:
    if isinstance(node, ast.Import):
        return [one.name for one in node.names]
    if not node.module:
        return []
    return [node.module, *(f"{node.module}.{one.name}" for one in node.names)]


def _holds_people(node: ast.ClassDef) -> bool:
    fields = (one.target for one in node.body if isinstance(one, ast.AnnAssign))
    return any(isinstance(one, ast.Name) and one.id in ("track_ids", "joints_m") for one in fields)


def main() -> None:
    """See the module."""
    rows = {part: measure(ROOT / part) for part in PARTS}
    print(" " * 12 + "".join(f"{key:>14}" for key in rows["tests"]))
    for part, row in rows.items():
        print(f"{part:12}" + "".join(f"{number:>14,}" for number in row.values()))
    if "--rooms" in sys.argv:
        for room in sorted((ROOT / "src/e3pose").glob("*/__init__.py")):
            print(f"  {room.parent.name:10}{measure(room.parent)['code']:>14,} code")


if __name__ == "__main__":
    main()
