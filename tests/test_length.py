"""Pages stay plain, and tuned numbers do not grow unseen."""

from __future__ import annotations

import ast
import importlib.util
import re
from collections.abc import Iterator
from typing import Any

import pytest
from tests.distributions import PACKAGES, ROOT

MOST_LINES_OF_PAGES = 4_040  # script, styles and markup of our own, all pages together


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


# How the comment of a number begins that is no tuning: indices, formulas, room for hostile views,
# what keeps arithmetic finite, when something is given up or tried again, people as they are.
NO_TUNING = ("layout", "definition", "capacity", "numerics", "timeout", "physical")


def _hooks() -> Any:
    spec = importlib.util.spec_from_file_location("hooks", ROOT / "docs" / "hooks.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


hooks = _hooks()


def tuned(source: str) -> Iterator[str]:
    """Yield the constants of a module that hold numbers which somebody chose."""
    lines = source.splitlines()
    for node in ast.parse(source).body:
        if not isinstance(node, ast.Assign):
            continue
        comment = lines[(node.end_lineno or node.lineno) - 1].partition("  # ")[2]
        if comment.split(":")[0] in NO_TUNING:
            continue
        names, values = node.targets[0], node.value
        together = isinstance(names, ast.Tuple) and isinstance(values, ast.Tuple)
        pairs = zip(names.elts, values.elts, strict=True) if together else [(names, values)]  # type: ignore[attr-defined]
        for name, value in pairs:
            plain = not isinstance(value, ast.Dict | ast.Lambda)
            constants = [n.value for n in ast.walk(value) if isinstance(n, ast.Constant)]
            chosen = any(type(constant) in (int, float) for constant in constants)
            if plain and chosen and isinstance(name, ast.Name) and name.id.isupper():
                yield name.id


def test_every_tuned_number_is_marked() -> None:
    """With its unit, what it was chosen on, and what it is worth, also where that is not known."""
    worth = {*hooks.worths((hooks.DIARY / hooks.TERMS).read_text()), hooks.NOT_MEASURED}
    halved = hooks.factors((hooks.DIARY / hooks.NUMBERS).read_text())
    assert len(worth) > 40
    for path in hooks.tuned_files():
        marks = list(hooks.marks(path.read_text()))
        marked = {name for mark in marks for name in mark.name.split(", ")}
        assert marked == {*tuned(path.read_text())}, path.name
        for mark in marks:
            known = mark.worth in worth or bool(re.search(r"\d|truth", mark.worth))
            if mark.worth == hooks.HALVED:
                known = (path.stem, mark.name) in halved
            assert mark.unit and mark.chosen_on and known, f"{path.name}: {mark}"


def test_marks_are_read() -> None:
    source = (
        "# Why.\n# tuned: s, m | on a scene,\n#   seed 1 | agility\nA, B = 1.0, 2.0  # c\nC = 3\n"
    )
    assert [*tuned(f"{source}D = 5  # numerics: of a loop\nE = A\nF = G(1, h=2)\nx = 4\n")] == [
        *"ABCF"
    ]
    (mark,) = hooks.marks(source)
    assert mark == ("A, B", "1.0, 2.0", "s, m", "on a scene, seed 1", "agility")
    with pytest.raises(ValueError, match="not enough values"):
        list(hooks.marks("# tuned: s | on a scene\nA = 1.0\n"))


def test_halves_and_doubles_are_read() -> None:
    page = (
        "| `births.(A, B)` | half | -1.2 | +2.8, -1.0 | 0.9 |\n"
        "| `births.(A, B)` | twice | nobody found | +0.0 | 100.0 |\n| other | half | 1 | 2 |\n"
    )
    found = hooks.factors(page)
    assert found == {("births", "A, B"): {"half": "+0.8 %", "twice": "loses people"}}
    known = {(path.stem, mark.name) for path in hooks.tuned_files("estimate/filter")
             for mark in hooks.marks(path.read_text())}  # fmt: skip
    measured = hooks.factors((hooks.DIARY / hooks.NUMBERS).read_text())
    assert len(measured) > 40 and len(measured.keys() & known) > 35
