"""The overview names a file for each of the paper's equations, and the file says which it has."""

from __future__ import annotations

import re

from tests.test_docs import ROOT

PAGE = ROOT / "docs" / "explanation" / "overview.md"
EQUATIONS = range(1, 10)  # of the paper
ROW = re.compile(r"^\| eq\. \((\d)\)(?: to \((\d)\))? \|.*`([\w/]+\.py)` \|$", re.MULTILINE)
CITED = re.compile(r"eq\. \((\d)\)(?: to \((\d)\))?")


def numbers(first: str, last: str) -> range:
    return range(int(first), int(last or first) + 1)


def test_every_equation_of_the_paper_has_a_row_and_its_file_cites_it() -> None:
    rows = ROW.findall(PAGE.read_text())
    assert [n for first, last, _ in rows for n in numbers(first, last)] == list(EQUATIONS)
    for first, last, name in rows:
        place = ROOT if name.startswith("lab/") else ROOT / "src" / "e3pose"
        source = (place / name).read_text()
        cited = {n for pair in CITED.findall(source) for n in numbers(*pair)}
        assert set(numbers(first, last)) <= cited, f"{name} cites {sorted(cited)}"
