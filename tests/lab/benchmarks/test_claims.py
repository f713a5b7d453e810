"""What the pages claim is marked, listed and repeated."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.test_docs import FENCE

import claims
from claims import Claim, dated, figure, listed, marks_of, pages, rewritten, within
from e3pose.base.errors import InputError

RUNS = listed(claims.LIST.read_text())
MARKS = [mark for page in pages() for mark in marks_of(page)]
# A figure of the front page: a decimal, a number with a unit, or any number among the results.
# Ports, versions, rates, counts and sizes of downloads are none.
NUMBER = re.compile(r"(?<![\w.-])[-+]?\d+(?:\.\d+)?(?![\w.]*\w)")
NOTE = r"(?:<!--.*?-->)?"
UNIT = re.compile(
    rf"\**{NOTE}(?: (?:to|and|or) \d+(?:\.\d+)?{NOTE})? ?(?:%|(?:mm|cm|px|points?|PCP|W|J|ms)\b)"
)
EXCUSED = re.compile(r"\**<!-- (?:claim: [a-z0-9.-]+|no claim: [^>]{10,}) -->")
NO_FIGURES = re.compile(
    r"\b\d of \d\b|`[^`\n]*`|\]\([^)]*\)|Python 3\.\d+ to 3\.\d+|Apache-2\.0|<!--.*?-->"
)


def unmarked(text: str) -> list[str]:
    """Return the figures of a page that have neither a mark nor a reason not to have one."""
    found, in_results = [], False
    for line in FENCE.sub("", text).splitlines():
        in_results = line == "## Results" or (in_results and not line.startswith("## "))
        results_from = line.rstrip("| ").rfind("|") if in_results and line[:1] == "|" else len(line)
        hidden = [m.span() for m in NO_FIGURES.finditer(line)]
        for number in NUMBER.finditer(line):
            here = number.start()
            if any(begin <= here < end for begin, end in hidden) or EXCUSED.match(
                line, number.end()
            ):
                continue
            if "." in number[0] or here > results_from or UNIT.match(line, number.end()):
                found.append(f"{number[0]} in: {line[max(0, here - 40) : here + 40]}")
    return found


def test_every_figure_of_the_front_page_has_a_mark() -> None:
    assert unmarked((claims.ROOT / "README.md").read_text()) == []


@pytest.mark.parametrize(
    ("line", "count"),
    [
        ("It saves 31 % of it.", 1),
        ("It saves 31<!-- claim: saved --> % of it.", 0),
        ("from 38 to 42 mm", 2),
        ("from 38<!-- claim: low --> to 42<!-- claim: high --> mm", 0),
        ("from 38<!-- claim: low --> to 42 mm", 1),
        ("they reach **97.1**, more than", 1),
        ("of 0.4<!-- no claim: the paper's share of cameras -->", 0),
        ("of 0.4<!-- no claim: so -->", 1),
        ("Python 3.10 to 3.13, `pip install a==1.2`, [2 mm](a-2.5.md), Apache-2.0", 1),
        ("60 MB, port 7447, 25 per second, cameras 1 and 2", 0),
        ("## Results\n\n| pizza, 30 per second | 1 of 5 | 30; round robin 31 |", 2),
        ("## Other\n\n| pizza, 30 per second | 1 of 5 | 30; round robin 31 |", 0),
    ],
)  # fmt: skip
def test_figures_without_a_mark_are_found(line: str, count: int) -> None:
    assert len(unmarked(line)) == count


def test_marks_and_list_agree() -> None:
    """Every mark is listed and every claim is marked, once on a page, and measured by one run."""
    named = Counter(name for run in RUNS.values() for name in run.claims)
    assert {mark.claim for mark in MARKS} == set(named)
    assert [name for name, count in named.items() if count > 1] == []
    on_page = Counter((mark.page.name, mark.claim) for mark in MARKS)
    assert [each for each, count in on_page.items() if count > 1] == []
    assert len(MARKS) >= 60
    said = {mark.claim: mark for mark in MARKS}
    for mark in MARKS:  # two pages say the same, in as many digits as each has
        other = said[mark.claim].said
        assert within(mark.said, float(other), 0.0) or within(other, float(mark.said), 0.0), mark


def test_every_run_stands_on_a_page_and_says_how_well_it_repeats() -> None:
    text = "".join(page.read_text() for page in pages())
    for name, run in RUNS.items():
        assert run.commands[-1] in text and run.checked and len(run.because.split()) > 3, name
    assert dated(RUNS) in (claims.ROOT / claims.DATED).read_text()
    assert 0 < sum(run.cpu_s for run in RUNS.values() if run.quick) <= 300


OUTPUT = '{"rows": [{"policy": "all", "mm": {"mean": 0.031, "sd": 1}}, {"policy": "one", "mm": 4}]}'


@pytest.mark.parametrize(
    ("output", "claim", "expected"),
    [
        (OUTPUT, Claim("/rows/policy=all/mm", times=1000), 31.0),
        (OUTPUT, Claim("/rows/1/mm"), 4.0),
        ("a 1.5\nb 2.5\n", Claim(r"^b ([\d.]+)"), 2.5),
        ("a 1.5\na 2.5\n", Claim(r"^a ([\d.]+)", take="most"), 2.5),
        ("a 1.5\na 2.5\n", Claim(r"^a ([\d.]+)", take="least"), 1.5),
        ("a 1.5\na 2.5\n", Claim(r"^a ([\d.]+)", take="mean"), 2.0),
    ],
)
def test_figure_is_found_in_the_output(output: str, claim: Claim, expected: float) -> None:
    assert figure(output, claim) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("output", "find"), [("a 1\na 2\n", r"a (\d)"), ("a 1", r"b (\d)"), (OUTPUT, "/rows/mm=5/mm")]
)
def test_figure_that_is_not_there_once_is_refused(output: str, find: str) -> None:
    with pytest.raises(InputError, match="expected one"):
        figure(output, Claim(find))


@pytest.mark.parametrize(
    ("said", "measured", "spread", "holds"),
    [
        ("97.1", 97.149, 0.0, True),
        ("97.1", 97.16, 0.0, False),
        ("97", 97.5, 0.0, True),
        ("-2", -1.4, 0.1, True),
        ("30", 31.7, 1.0, False),
    ],
)
def test_figure_holds_within_spread_and_digits(
    said: str, measured: float, spread: float, holds: bool
) -> None:
    assert within(said, measured, spread) == holds


def test_figures_are_written_in_the_digits_of_the_page() -> None:
    text = "**97.1**<!-- claim: pcp --> and +3<!-- claim: gain --> %, 2<!-- claim: other -->"
    assert rewritten(text, {"pcp": 96.04, "gain": 4.2}) == (
        "**96.0**<!-- claim: pcp --> and +4<!-- claim: gain --> %, 2<!-- claim: other -->"
    )


LIST = """
[mean]
commands = ["python -c \\"print('mm 31.4')\\"", "python -c \\"print('mm', 3 + 28.4)\\""]
spread = 0.3
because = "nothing about it is random"
quick = true
claims = { error-mm = 'mm ([\\d.]+)' }

[broken]
commands = ["python -c \\"raise SystemExit('no camera')\\""]
spread = 0.0
because = "it never gets that far"
claims = { no-figure = '(1)' }

[real]
commands = ["python -c print($E3POSE_SHARED)"]
spread = 0.0
because = "it never gets that far"
quick = true
claims = { real-mm = '(1)' }
"""


def _claimed(folder: Path, monkeypatch: pytest.MonkeyPatch, said: str) -> Path:
    (folder / "docs/research").mkdir(parents=True)
    (folder / claims.DATED).write_text("# Research\n\nLast repeated: never.\n")
    page = folder / "README.md"
    page.write_text(
        f"{said}<!-- claim: error-mm --> mm, 1<!-- claim: no-figure -->, 1<!-- claim: real-mm -->\n"
    )
    (folder / "claims.toml").write_text(LIST)
    monkeypatch.setattr(claims, "ROOT", folder)
    monkeypatch.setattr(claims, "LIST", folder / "claims.toml")
    monkeypatch.delenv("E3POSE_SHARED", raising=False)
    return page


def _main(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["claims.py", *words])
    return claims.main()


def test_run_compares_says_what_was_left_out_and_writes_what_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    page = _claimed(tmp_path, monkeypatch, "29.00")
    assert _main(monkeypatch, "--all") == 1
    said = capsys.readouterr().out
    assert "OFF  error-mm" in said and "FAILED" in said and "no camera" in said
    assert page.read_text().startswith("29.00<!--")
    assert _main(monkeypatch, "error-mm", "--write") == 1
    assert page.read_text().startswith("31.40<!--")
    assert _main(monkeypatch, "mean", "--write") == 0
    run = listed(claims.LIST.read_text())["mean"]
    assert run.checked is not None
    dated_page = (tmp_path / claims.DATED).read_text()
    line = f"Last repeated: 1 figure by 1 command, {run.checked} to {run.checked}."
    assert line in dated_page
    capsys.readouterr()
    assert _main(monkeypatch) == 0
    said = capsys.readouterr().out
    assert "ok   error-mm" in said and "README.md: 31.40, measured 31.4, spread 0.3" in said
    assert "left out: real needs E3POSE_SHARED" in said and "broken" not in said


TABLES = """
[tables]
commands = ["python -c \\"open('a.csv','w').write('SA,1')\\"",
            "python -c \\"open('b.csv','w').write('E = 3,2')\\""]
file = "*.csv"
spread = 0.0
because = "nothing about it is random"
each = { all = "SA", three = "E = 3" }
claims = { "mm-$each" = '$each,(.)', other = '(2)' }
"""


def test_claims_of_several_rows_are_found_in_several_files() -> None:
    (run,) = listed(TABLES).values()
    measured = {name: figure(claims.output_of(run), claim) for name, claim in run.claims.items()}
    assert measured == {"mm-all": 1.0, "mm-three": 2.0, "other": 2.0}
    with pytest.raises(InputError, match=r"no \*\.txt was written"):
        claims.output_of(msgspec.structs.replace(run, file="*.txt"))


def test_unknown_names_and_keys_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _claimed(tmp_path, monkeypatch, "31")
    with pytest.raises(InputError, match=r"no run or claim .* is called pizza"):
        _main(monkeypatch, "pizza")
    with pytest.raises(InputError, match="unknown field `speed`"):
        listed(LIST.replace("quick", "speed"))


def test_mark_apart_from_its_number_is_refused(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("31 mm<!-- claim: error-mm -->")
    with pytest.raises(InputError, match="right behind a number"):
        marks_of(page)
