"""The page about other tools: what it shows runs on an archive, and all tools count the same."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path
from typing import Any

import pytest
from tests.output.archive.days import BEGIN, DAY, FIRST_DAY, HOUR, SECOND_DAY, fill

from e3pose.output.archive.places import Folder
from e3pose.output.archive.writing import archive_store

pytestmark = pytest.mark.slow
PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "read-archives.md"
SITES = ("gym", "hall")


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Archive 26 hours of two sites, with two people in each."""
    folder = tmp_path_factory.mktemp("archive")
    for site in SITES:
        fill(folder / f"{site}.db", range(26), site)
        archive_store(folder / f"{site}.db", None, Folder(folder / "to"), BEGIN + DAY + 4 * HOUR)
    return folder / "to"


def run_examples(archive: Path, part: str) -> tuple[dict[str, Any], list[str]]:
    """Return what the Python of a part of the page leaves, and what its SQL is."""
    (text,) = re.findall(rf"^## {part}\n(.*?)^## ", PAGE.read_text(), re.M | re.S)
    text, scope = text.replace("/mnt/archive", str(archive)), dict[str, Any]()
    (code,) = re.findall(r"```python\n(.*?)```", text, re.S)
    with contextlib.redirect_stdout(io.StringIO()) as said:
        exec(code, scope)
    assert FIRST_DAY in said.getvalue() and SITES[1] in said.getvalue()
    return scope, re.findall(r"```sql\n(.*?)```", text, re.S)


EXPECTED = [(site, day, 2) for site in SITES for day in (FIRST_DAY, SECOND_DAY)]


def test_duckdb_counts_people_and_knows_when_they_were_there(archive: Path) -> None:
    scope, questions = run_examples(archive, "DuckDB")
    people = scope["people"].fetchall()
    assert [(site, str(day), count) for site, day, count in people] == EXPECTED
    ways, seen = (scope["duckdb"].sql(sql).fetchall() for sql in questions)
    # A metre from slot to slot, of 0.04 s.
    assert ways == [(site, pytest.approx(2 * (26 * 60 - 1)), pytest.approx(25)) for site in SITES]
    assert [row[:2] for row in seen] == [(site, FIRST_DAY[:7]) for site in SITES]
    first = scope["duckdb"].sql("SELECT epoch_ns(min(time)), max(slot) FROM poses").fetchall()
    assert first == [(BEGIN, 26 * 60 - 1)]
    scope["duckdb"].sql("DROP VIEW poses")


def test_polars_and_pandas_count_the_same(archive: Path) -> None:
    scope, _ = run_examples(archive, "Polars")
    found = scope["poses"].group_by("site", "day").agg(scope["people"]).sort("site", "day")
    assert [(site, str(day), count) for site, day, count in found.collect().rows()] == EXPECTED

    scope, _ = run_examples(archive, "pandas")
    counts = scope["people"].groupby(["site", "day"]).size()
    assert [(*names, count) for names, count in counts.items()] == EXPECTED
