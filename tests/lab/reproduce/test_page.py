"""The pages of reproductions: what they name, and what they say of the paper."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from tests.distributions import ROOT

from e3pose_lab.reproduce.items import ITEMS, Item, Scale
from e3pose_lab.reproduce.job import reproduce
from e3pose_lab.reproduce.page import shown
from e3pose_lab.reproduce.records import Headline, Line, Panel, Section, Spread, Table
from e3pose_lab.reproduce.sources import WHERE, Sources, load_sources
from e3pose_lab.reproduce.work import Made, Piece
from e3pose_lab.workers import Workers

NAN = float("nan")
ONE = Line("one", "measured", (1, 2), (3, NAN), (2, 2), (4, 4))


def section(scale: Scale, made: Made) -> Section:
    names = ("a", "b")
    return Section(
        paper="<b>97.1</b>",
        ours="ours, by `a < b`",
        why="",
        how="how",
        tables=(
            Table("table", "T", ("row", "PCP"), (
                ("x", Spread(95.04, 0.5, 3)), ("y", None), ("z", Spread(1, 0, 1)),
            )),
            Table("small", "S", ("row", "PCP", "IoU"), (("x", 95.04, -0.0001),), (0, 1, 3)),
            Table("long", "All <rows>", ("row", "PCP"), (("x", 1.0),), folded=True),
        ),
        panels=(
            Panel("lines", "L", "x", "y", (ONE,)),
            Panel("bars", "B", "", "W", (
                Line("paper", "paper", names, (1, 2)), Line("here", "modelled", names, (2, 3)),
            ), kind="bars"),
            Panel("stack", "S", "", "W", (Line("cpu", "modelled", names, (1, 2)),), kind="stacked"),
            Panel("points", "Q", "", "PCP, %", (
                Line("paper", "paper", names, (94, 95)),
                Line("here, in words that fill a line of the legend", "measured", names, (93, 96),
                     (92, 95), (94, 97)),
            ), kind="points"),
            Panel("decades", "D", "x", "mm", (
                Line("one", "simulated", (1, 2, 3), (20, 50, 190)),
            ), logarithmic_y=True),
            Panel("steps", "R", "slot", "", (ONE,), kind="steps"),
            Panel("limbs", "P", "px right", "px down", (ONE, replace(ONE, second=True)), "limbs"),
        ),
        headlines=(
            Headline("PCP", 95.0, 94.0, 96.0, 97.1),
            Headline("saved", 25.0, 20.0, 30.0, (20.66, 31.21)),
            Headline("error", 50.0, 10.0, 20.0),
        ),
    )  # fmt: skip


HERE = Item("here", "An item", "table:x", lambda scale: [], section)
AWAY = Item("away", "On Shelf", "", lambda scale: [], section, needs=("shelf",))
ABSENT = Item("absent", "Needs", "", lambda scale: [], section, imports=("json", "no_such_library"))


@dataclass(frozen=True, slots=True)
class Asked:
    number: int


def fails(sources: Sources, asked: Asked) -> int:
    raise RuntimeError("<nothing> works")


BROKEN = Item("broken", "Breaks", "", lambda scale: [Piece(fails, Asked(1))], section)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("reproduced")
    outcome = reproduce(made, Sources(), Workers(1), items=(HERE, AWAY))
    assert [h.name for h in outcome.wrong] == ["error"]
    assert [title for title, _ in outcome.skipped] == ["On Shelf"] and not outcome.failed
    return made


def test_what_fails_or_is_lacking_is_left_out_with_the_reason(tmp_path: Path) -> None:
    def fails_to_show(scale: Scale, made: Made) -> Section:
        raise ZeroDivisionError("no slots")

    (tmp_path / "data" / "shelf").mkdir(parents=True)
    (tmp_path / "data" / "shelf" / "shelf.npz").write_bytes(b"PK" + bytes(100))
    sources = load_sources(tmp_path / "data")
    unshown = Item("unshown", "Unshown", "", lambda scale: [], fails_to_show)
    items = (unshown, HERE, ABSENT, BROKEN, AWAY)
    outcome = reproduce(tmp_path / "out", sources, Workers(1), items=items)
    assert outcome.failed and len(outcome.headlines) == 3
    page = outcome.page.read_text()
    assert "Skipped: no_such_library is not installed: pip install" in page
    assert "Skipped: test_page-fails: RuntimeError: &lt;nothing&gt; works" in page
    assert "Skipped: unshown: ZeroDivisionError: no slots" in page
    assert "shelf.npz: found no .npz archive" in page
    assert (tmp_path / "out" / "figures" / "lines.svg").exists()


def test_page_says_what_was_found_beside_the_papers_figures(folder: Path) -> None:
    page = (folder / "report.html").read_text()
    assert "&lt;b&gt;97.1" in page and "<b>97.1" not in page, "words are escaped"
    assert "ours, by <code>a &lt; b</code>" in page
    assert "Skipped: no data; expected Shelf" in page
    assert "Not what was found here before: error" in page
    assert "http" not in page.replace("http-equiv", "").lower().split("</style>")[0]
    assert "<td>95.00</td><td>97.1</td><td>-2.10</td><td>94 to 96</td>" in page
    assert "<td>25.00</td><td>20.66 to 31.21</td><td>+0.00</td><td>20 to 30</td>" in page
    assert '<td class="bad">50.00</td><td>–</td><td>–</td><td>10 to 20</td>' in page
    assert "they say nothing about the paper" in page
    assert "<td>x</td><td>95.0</td><td>0.000</td>" in page, "decimals of a column, zero no sign"
    assert 'alt="B: W"' in page and 'alt="L: y against x"' in page
    assert page.count("<details>") == 1, "a long table is folded"
    assert "<details><summary>All &lt;rows&gt;</summary>" in page


def test_every_panel_is_a_picture_and_a_csv(folder: Path) -> None:
    for name in ("lines", "bars", "stack", "points", "decades", "steps", "limbs"):
        assert (folder / "figures" / f"{name}.svg").read_text().startswith("<?xml")
    assert "(modelled)" in (folder / "figures" / "bars.svg").read_text()
    ticks = (folder / "figures" / "decades.svg").read_text()
    assert all(f">{mm}</text>" in ticks for mm in (20, 50, 100, 200))
    rows = list(csv.reader((folder / "figures" / "bars.csv").read_text().splitlines()))
    assert rows[1:3] == [["paper", "paper", "a", "1", "", ""], ["paper", "paper", "b", "2", "", ""]]


def test_a_table_keeps_its_spread(folder: Path) -> None:
    assert (folder / "tables" / "long.csv").exists()
    rows = list(csv.reader((folder / "tables" / "table.csv").read_text().splitlines()))
    assert rows == [
        ["row", "PCP", "PCP, standard deviation"],
        ["x", "95.04", "0.5"],
        ["y", "", ""],
        ["z", "1", ""],
    ]


@pytest.mark.parametrize(
    ("cell", "text"),
    [(1.25, "1.2"), (NAN, "–"), (None, "–"), ("a", "a"), (Spread(1, 0.5, 2), "1.0 ± 0.5"),
     (Spread(1, 0, 1), "1.0")],
)  # fmt: skip
def test_cells(cell: str | float | Spread | None, text: str) -> None:
    assert shown(cell, 1) == text


def test_items_have_names_of_their_own() -> None:
    assert len({item.key for item in ITEMS}) == len(ITEMS)
    assert all(set(item.needs) <= set(WHERE) for item in ITEMS)


PAGE = ROOT / "docs" / "research" / "paper-statements.md"
LABEL = re.compile(r"\\label\{((?:fig|eq|table|alg):\w+)\}")
PART = re.compile(r"\\subfigure\[[^\]]*\]\{\s*\\label\{([^}]*)\}")


def test_every_item_of_a_picture_or_table_is_on_the_page() -> None:
    text = PAGE.read_text()
    for item in ITEMS:
        if item.label:
            assert f"`{item.key}`" in text, item.key


@pytest.mark.shared
def test_everything_that_the_paper_numbers_is_on_the_page(shared: Path) -> None:
    tex = (shared / "paper" / "e3pose.tex").read_text()
    wanted = set(LABEL.findall(tex)) - set(PART.findall(tex))
    text = PAGE.read_text()
    assert len(wanted) > 20
    assert not {label for label in wanted if label not in text}
    for item in ITEMS:
        assert all(label in tex for label in item.label.split(", ")), item.key
