"""The page of a week adds up what the store has, by the names that people have."""

from __future__ import annotations

import csv
import json
import re
from datetime import date
from pathlib import Path

import pytest
from tests.cli.commands import run
from tests.output.report.stored_week import LAST, SITE, site_file, write_week

from e3pose.base.errors import InputError
from e3pose.output.report.week import EVERYBODY, NO_NAME, Week, joined, week_of
from e3pose.output.report.week_page import amount, render, sentences
from e3pose.store import Store

HOUR = 3600.0


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_week(tmp_path_factory.mktemp("week") / "poses.db")


@pytest.fixture(scope="module")
def week(place: Path) -> Week:
    return week_of(Store(place), str(place), SITE, LAST)


def test_amounts_are_those_of_the_store(week: Week) -> None:
    assert week.days[0] == date(2026, 11, 20) and week.people == ["Ada", NO_NAME]
    ada = {what: week.total("Ada", *what) for what in
           (("there", ""), ("zone", "bed"), ("state", "lying"), ("state", "walking"))}  # fmt: skip
    hours = {what: seconds / HOUR for what, seconds in ada.items()}
    assert hours["there", ""] == pytest.approx(7 * 2.0)
    assert hours["zone", "bed"] == hours["state", "lying"] == pytest.approx(7 * 0.5)
    assert hours["state", "walking"] == pytest.approx(7 * 80 / 60), "not with somebody else"
    assert week.total(NO_NAME, "there") == pytest.approx(7 * 600)
    assert week.total(EVERYBODY, "watched") == 7 * 4 * HOUR
    assert week.total(EVERYBODY, "nobody") == 7 * 2 * HOUR
    assert week.total(EVERYBODY, "state", "walking") == pytest.approx(7 * 100 * 60)


def test_events_are_told_once_with_how_long_they_lasted(week: Week) -> None:
    assert [(one.kind, one.who, one.zone, one.lasted_s) for one in week.events] == [
        ("fall", "Ada", "bed", None), ("on-floor", "Ada", "bed", 90.0),
        ("got-up", "Ada", "bed", None),
    ]  # fmt: skip
    assert week.figures["Ada", "event", "fall"] == [0.0] * 6 + [1.0]


def test_two_sentences_say_it(week: Week) -> None:
    first, second = sentences(week)
    assert first == (
        "Ada for 14.0 h and people without a name for 70 min were there; nobody was seen for "
        "14.0 h of 28.0 h that were watched."
    )
    assert second == (
        "1 fall and 1 long lie on the floor were told, the last of Ada near bed on Thursday 26 "
        "November at 08:40."
    )


def test_a_quiet_day_says_so(place: Path) -> None:
    day = week_of(Store(place), str(place), SITE, date(2026, 11, 21), 1)
    assert sentences(day)[1] == "No fall and no long lie on the floor was told."
    assert "Saturday, 21 November 2026" in render(day)


def test_days_without_the_site_are_refused(place: Path) -> None:
    with pytest.raises(InputError, match="2026-10-01"):
        week_of(Store(place), str(place), SITE, date(2026, 10, 7))
    with pytest.raises(InputError, match="--days: found 32"):
        week_of(Store(place), str(place), SITE, LAST, 32)


def test_the_page_is_one_file_that_runs_nothing(tmp_path: Path) -> None:
    place = write_week(tmp_path / "poses.db", name="<b onclick=x>&Ada</b>")
    text = render(week_of(Store(place), str(place), SITE, LAST))
    assert (
        "default-src 'none'" in text
        and "<script" not in text
        and "http" not in text.replace("http-equiv", "")
    )
    assert "<b onclick" not in text and "&lt;b onclick=x&gt;&amp;Ada" in text
    assert text.count("<section>") == text.count("</section>") >= 4


def test_the_verb_writes_page_and_tables(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_week(tmp_path / "poses.db")
    site = site_file(tmp_path)
    page, table = tmp_path / "week.html", tmp_path / "week.csv"
    words = ("events", "week", site, page, "--to", LAST.isoformat(), "--csv", table)
    assert run(*words) == 0
    assert "1 fall and 1 long lie" in capfd.readouterr().out
    assert page.stat().st_mode & 0o077 == 0, "names are in it"
    with table.open() as file:
        rows = list(csv.DictReader(file))
    (fell,) = (r for r in rows if (r["who"], r["name"], float(r["amount"])) == ("Ada", "fall", 1.0))
    assert fell["day"] == "2026-11-26" and fell["unit"] == "count"
    assert run("events", "week", site, "--to", LAST.isoformat(), "--json", "-") == 0
    assert len(json.loads(capfd.readouterr().out)) == len(rows)
    shown = re.sub(r"<[^>]+>", " ", page.read_text())
    assert "Ada" in shown and "together" in shown


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["week.txt"], "expected a name ending in .html"),
        (["--to", "yesterday"], "--to: found 'yesterday'"),
        (["--days", "0"], "--days: found 0"),
        (["--csv", "poses.db"], "found the store itself"),
    ],
)
def test_what_cannot_be_is_refused(
    tmp_path: Path,
    words: list[str],
    said: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_week(tmp_path / "poses.db")
    assert run("events", "week", site_file(tmp_path), *words) == 2
    assert said in capsys.readouterr().err


def test_spans_that_touch_are_one() -> None:
    assert joined([(5, 9), (0, 3), (3, 4), (8, 12), (7, 7)]) == [(0, 4), (5, 12)]


def test_times_are_written_as_people_say_them() -> None:
    said = [amount(seconds) for seconds in (0, 45, 90, 150, 5400, 86400)]
    assert said == ["0 s", "45 s", "90 s", "2 min", "1.5 h", "24.0 h"]
