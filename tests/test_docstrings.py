"""What docstrings list under Args and Attributes exists."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from tests.cases import each_case
from tests.distributions import PACKAGES, ROOT

ROOMS = sorted(
    path for package in PACKAGES.values() for path in package.iterdir() if path.name != "py.typed"
)
LISTED = re.compile(r"^(?:Args|Attributes):\n((?:    .*\n|\n)+)", re.M)
NAME = re.compile(r"^    \*{0,2}(\w+):", re.M)
RIDDLE = re.compile(r"^(What|Who|Whose|Those)\b|\b[Rr]eturn (what|who|whose)\b|\bthose who\b")
Documented = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def listed(node: Documented) -> set[str]:
    """Return the names that the docstring of a function or a class explains."""
    sections = LISTED.findall(f"{ast.get_docstring(node) or ''}\n")
    return {name for section in sections for name in NAME.findall(section)}


def existing(node: Documented) -> set[str]:
    """Return the arguments of a function, or the fields, properties and arguments of a class."""
    if not isinstance(node, ast.ClassDef):
        every = ast.walk(node.args)
        return {each.arg for each in every if isinstance(each, ast.arg)}
    found = {each.target.id for each in node.body if isinstance(each, ast.AnnAssign)
             and isinstance(each.target, ast.Name)}  # fmt: skip
    for method in node.body:
        if isinstance(method, ast.FunctionDef):
            found |= {method.name} | (existing(method) if method.name == "__init__" else set())
            found |= {
                each.attr
                for each in ast.walk(method)
                if isinstance(each, ast.Attribute) and isinstance(each.ctx, ast.Store)
            }
    return found


@each_case("room", ROOMS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_docstrings_list_what_exists(room: Path) -> None:
    stale = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {node.name}: {name}"
        for path in (sorted(room.rglob("*.py")) if room.is_dir() else [room])
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, Documented)
        for name in sorted(listed(node) - existing(node))
    ]
    assert not stale, "\n".join(stale)


@each_case("room", ("edge", "estimate", "select", "site", "store"))
def test_first_lines_name_what_they_are_about(room: str) -> None:
    trees = (ast.parse(path.read_text()) for path in (PACKAGES["e3pose"] / room).rglob("*.py"))
    nodes = (n for tree in trees for n in ast.walk(tree) if isinstance(n, Documented | ast.Module))
    firsts = [line for n in nodes for line in (ast.get_docstring(n) or "").splitlines()[:1]]
    assert len(firsts) > 50 and not list(filter(RIDDLE.search, firsts))


def test_a_name_that_is_gone_is_found() -> None:
    lines = ("def f(a: int) -> None:", '"""Do.', "", "Args:", "    a: one.", "    b: two.", '"""')
    text = "\n    ".join(lines)
    (node,) = ast.parse(text).body
    assert isinstance(node, ast.FunctionDef)
    assert listed(node) - existing(node) == {"b"}
