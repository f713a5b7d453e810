"""Pages stay plain, and tuned numbers do not grow unseen."""

from __future__ import annotations

import ast
import importlib.util
import re
from collections.abc import Iterator
from typing import Any

import pytest
from tests.cases import each_case
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
MOST = {
    "estimate/filter": 126,
    "model/proportions.py": 5,
    "estimate/per_slot": 9,
    "estimate/smooth": 4,
    "select": 56,
    "calibrate/resection.py": 2,
}


def _hooks() -> Any:
    spec = importlib.util.spec_from_file_location("hooks", ROOT / "docs" / "hooks.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


hooks = _hooks()


def numbers(value: ast.expr) -> int:
    """Return how many numbers an expression holds; arithmetic on numbers makes one."""
    if isinstance(value, ast.Call):
        parts = [*value.args, *(keyword.value for keyword in value.keywords)]
        return sum(numbers(part) for part in parts)
    return int(any(isinstance(n, ast.Constant) and type(n.value) in (int, float)
                   for n in ast.walk(value)))  # fmt: skip


def tuned(source: str) -> Iterator[tuple[str, int]]:
    """Yield the constants of a module that somebody chose, and how many numbers each has."""
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
            count = 0 if isinstance(value, ast.Dict | ast.Lambda) else numbers(value)
            if count and isinstance(name, ast.Name) and name.id.isupper():
                yield name.id, count


def test_every_tuned_number_is_marked() -> None:
    """With its unit, what it was chosen on, and what it is worth, also where that is not known."""
    worth = {*hooks.worths((hooks.DIARY / hooks.TERMS).read_text()), hooks.NOT_MEASURED}
    halved = hooks.factors((hooks.DIARY / hooks.NUMBERS).read_text())
    assert len(worth) > 40
    for path in hooks.tuned_files():
        marks = list(hooks.marks(path.read_text()))
        marked = {name for mark in marks for name in mark.name.split(", ")}
        assert marked == {name for name, _ in tuned(path.read_text())}, path.name
        for mark in marks:
            known = mark.worth in worth or bool(re.search(r"\d|truth", mark.worth))
            if mark.worth == hooks.HALVED:
                known = (path.stem, mark.name) in halved
            assert mark.unit and mark.chosen_on and known, f"{path.name}: {mark}"


def test_marks_are_read() -> None:
    source = (
        "# Why.\n# tuned: s, m | on a scene,\n#   seed 1 | agility\nA, B = 1.0, 2.0  # c\nC = 3\n"
    )
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


@each_case("place", hooks.TUNED)
def test_tuned_numbers_are_no_more_than_they_were(place: str) -> None:
    found = {
        f"{path.name}: {name}": count
        for path in hooks.tuned_files(place)
        for name, count in tuned(path.read_text())
    }
    total = sum(found.values())
    listed = "\n".join(found)
    assert total <= MOST[place], f"{total} tuned numbers in {len(found)} constants:\n{listed}"


def test_numbers_are_counted() -> None:
    source = (
        "A, B = 1.0, 2 / 3\nC = Habit(1.0, 0.5, usual_m=0.2)\nD = 5  # numerics: of a loop\n"
        "E = A\nF = 3.0  # metres\nx = 4\n"
    )
    assert dict(tuned(source)) == {"A": 1, "B": 1, "C": 3, "F": 1}
