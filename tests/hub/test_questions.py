"""Questions over a month of several sites: the page's own ten, from a terminal and from Python."""

from __future__ import annotations

import json
import re
import sqlite3
from pathlib import Path

import pytest
from tests.cli.commands import run as run_verb
from tests.postgres import Server

from e3pose.base.errors import InputError
from e3pose.hub import accesses as log
from e3pose.hub.accesses import local_user, log_accesses, read_accesses
from e3pose.hub.archives import answer_of_archives
from e3pose.hub.database import Cursor, keep, open_hub
from e3pose.hub.frames import query
from e3pose.hub.question import answer
from e3pose.hub.settings import load_hub
from e3pose.output.archive.places import Folder, place_of
from simulated_sites import (
    BEGIN_NS,
    CAMERAS,
    SLOTS,
    WALK_MPS,
    archive_days,
    records_of,
    summaries_of,
)

pytestmark = pytest.mark.slow

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "ask-many-sites.md"
SITES = {"lab": "clinics", "hall": "clinics", "gym": "sports"}
DAYS = 30
MINUTES = 1440 * DAYS


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a hub with a month of three sites, one archive in a folder and one behind fsspec."""
    folder = tmp_path_factory.mktemp("house")
    lines = ['format = "e3pose-hub"', "version = 1"]
    lines.append(f'archives = ["archive", "local://{folder}/far"]')
    for at, (site, group) in enumerate(SITES.items()):
        lines += ["[[site]]", f'name = "{site}"', f'group = "{group}"']
        lines.append(f'endpoint = "tcp/127.0.0.1:{7000 + at}"')
        place = Folder(folder / "archive") if at else place_of(f"local://{folder}/far")
        archive_days(place, site, at, DAYS)
    (folder / "hub.toml").write_text("\n".join(lines))
    engine = open_hub(str(folder / "hub.db"))
    for at, site in enumerate(SITES):
        keep(engine, site, [*records_of(at, 0, MINUTES)], Cursor(1, MINUTES), 1)
    return folder


def questions() -> dict[str, str]:
    """Return the questions of the page by their heading."""
    found = re.findall(
        r"^### ([^\n]*)\n\n(?:Of [^\n]*\n\n)?```sql\n(.*?)```", PAGE.read_text(), re.M | re.S
    )
    assert len(found) == 10
    return dict(found)


def ask(house: Path, heading: str) -> list[tuple[object, ...]]:
    sql = questions()[heading]
    table = query(house, sql, archives=bool(re.search(r"FROM poses", sql)))
    return list(table.itertuples(index=False, name=None))


def test_every_question_has_rows(house: Path) -> None:
    for heading in questions():
        rows = ask(house, heading)
        assert rows or heading == "Was anybody there at night?", heading


def test_answers_about_summaries_are_those_of_what_was_made(house: Path) -> None:
    made = {site: [*summaries_of(at, 0, MINUTES)] for at, site in enumerate(SITES)}
    falls = {
        site: sum(json.loads(row["events"]).get("fall begun", 0) for row in rows)
        for site, rows in made.items()
    }
    found = dict.fromkeys(SITES, 0)
    for site, _, count in ask(house, "How many falls were there, by week?"):
        found[str(site)] += int(count)  # type: ignore[call-overload]
    assert found == falls and min(falls.values()) > 0
    kitchen = sum(json.loads(row["zones"]).get("kitchen", 0) for row in made["gym"]) / 60
    stays = {
        (site, zone): hours for site, zone, hours in ask(house, "How long do people stay where?")
    }
    assert stays["gym", "kitchen"] == pytest.approx(kitchen)
    watts = ask(house, "How many watts does each site draw, and how much of it is measured?")
    for _, drawn, measured in watts:
        assert drawn == pytest.approx(2 * 6 + 2 * 3) and measured == pytest.approx(0.5)
    blind = {site: share for site, share, _ in ask(house, "Where did cameras see nothing?")}
    slots = sum(sum(json.loads(row["blind"]).values()) for row in made["hall"])
    assert blind["hall"] == pytest.approx(slots / (MINUTES * 1500))
    low = ask(house, "Which cameras are lost often, and whose battery runs low?")
    lost = {what: found for site, what, found in low if site == "lab"}
    minutes = [f"camera-lost {CAMERAS[2]}" in json.loads(row["faults"]) for row in made["lab"]]
    assert lost["minutes lost: cam3"] == sum(minutes) > 0
    assert ask(house, "Was anybody there at night?") == []
    busiest = ask(house, "When is each site busiest?")
    assert all(8 <= hour < 18 for _, hour, _, _ in busiest)  # type: ignore[operator]
    assert busiest[0][0] == "gym"


def in_postgresql(sql: str) -> str:
    """Return a question as the page's table says that PostgreSQL has it."""
    pairs = re.findall(r"^\| `([^`]*\([^`]*)` \| `([^`]*)`", PAGE.read_text(), re.M)
    assert len(pairs) == 4
    for old, new in pairs:
        for name in ("zones", "faults", "charge"):
            sql = sql.replace(old.replace("zones", name), new.replace("zones", name))
    return sql


def test_questions_have_the_same_answers_in_postgresql(tmp_path: Path, postgres: Server) -> None:
    databases = str(tmp_path / "hub.db"), postgres.new_database()
    for database in databases:
        engine = open_hub(database)
        for at, site in enumerate(SITES):
            keep(engine, site, [*records_of(at, 0, 2000)], Cursor(1, 2000), 1)
        engine.dispose()
    for heading, sql in questions().items():
        if "FROM poses" in sql:
            continue
        mine, yours = (
            sorted(answer(database, words)[1], key=str)
            for database, words in zip(databases, (sql, in_postgresql(sql)), strict=True)
        )
        assert len(mine) == len(yours), heading
        for row, other in zip(mine, yours, strict=True):
            assert row[0] == other[0], heading
            assert float(row[-1]) == pytest.approx(float(other[-1])), heading


def test_answers_about_poses_are_those_of_what_was_made(house: Path) -> None:
    people = ask(house, "How many people came each day?")
    assert len(people) == 3 * DAYS and {count for *_, count in people} == {2}
    for _, way_m, mean_mps in ask(house, "How far and how fast do people walk?"):
        assert way_m == pytest.approx(DAYS * 2 * (SLOTS - 1) * WALK_MPS)
        assert mean_mps == pytest.approx(WALK_MPS)
    seen = ask(house, "How well are people seen?")
    assert [(site, month) for site, month, *_ in seen] == [(s, "2026-11") for s in sorted(SITES)]
    assert [share for *_, share, _ in seen] == pytest.approx([0.9] * 3, abs=0.01)


def test_access_to_poses_is_logged_and_limited_to_a_group(
    house: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sql = "SELECT DISTINCT site, day FROM poses ORDER BY ALL LIMIT 40"
    before = len(read_accesses(str(house / "hub.db"), limit=10_000))
    assert run_verb("hub", "query", house, sql, "--archives", "--group", "sports") == 0
    shown = capsys.readouterr().out
    assert "gym" in shown and "lab" not in shown and "2026-11-01" in shown
    newest, *_ = found = read_accesses(str(house / "hub.db"), limit=10_000)
    assert len(found) == before + 1, "of the one site that it could read"
    assert (newest.who, newest.site, newest.what) == (local_user(), "gym", f"query: {sql}")
    assert run_verb("hub", "accesses", house, "--site", "gym", "--limit", "1") == 0
    listed = capsys.readouterr().out
    assert "query: SELECT DISTINCT" in listed and "gym" in listed
    assert run_verb("hub", "accesses", house, "--who", "nobody") == 0
    assert capsys.readouterr().out.split() == ["time", "who", "site", "what"]
    with pytest.raises(InputError, match="group: found 'shops', expected one of clinics, sports"):
        query(house, sql, archives=True, groups=["shops"])


def test_without_a_log_there_is_no_answer(house: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with sqlite3.connect(house / "hub.db") as connection:
        connection.execute("ALTER TABLE accesses RENAME TO gone")
    try:
        monkeypatch.setattr("e3pose.hub.archives.open_hub", lambda _: _engine(house))
        with pytest.raises(InputError, match="access cannot be logged"):
            query(house, "SELECT 1", archives=True)
    finally:
        with sqlite3.connect(house / "hub.db") as connection:
            connection.execute("ALTER TABLE gone RENAME TO accesses")


def _engine(house: Path) -> object:
    from e3pose.store.database import writing_engine

    return writing_engine(f"sqlite:///{house / 'hub.db'}")


def test_log_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log, "MOST", 5)
    monkeypatch.setattr(log, "SPARE", 1)
    engine = open_hub(str(tmp_path / "hub.db"))
    for number in range(9):
        log_accesses(engine, f"user{number}", ["lab"], "x" * 1000)
    found = read_accesses(str(tmp_path / "hub.db"))
    assert [one.who for one in found] == [f"user{number}" for number in (8, 7, 6, 5, 4)]
    assert len(found[0].what) == 500


@pytest.mark.parametrize(
    "sql",
    [
        "SELECT * FROM read_text('/etc/passwd')",
        "SELECT * FROM read_parquet('{house}/archive/*/*/*.parquet')",
        "SELECT * FROM read_csv('http://127.0.0.1:1/x.csv')",
        "SELECT * FROM glob('/*')",
        "COPY poses TO '{house}/copy.csv'",
        "ATTACH '{house}/hub.db'",
        "INSTALL httpfs",
        "LOAD httpfs",
        "SET enable_external_access = true",
        "CREATE TABLE mine AS SELECT 1",
        "SELECT 1; SELECT 2",
        "EXPORT DATABASE '{house}/all'",
        "SELEC",
        "",
    ],
)
def test_question_about_archives_reads_and_nothing_else(house: Path, sql: str) -> None:
    before = sorted(house.rglob("*.csv"))
    with pytest.raises(InputError, match=r"^query: .*, expected one SELECT from poses or files$"):
        query(house, sql.format(house=house), archives=True)
    assert sorted(house.rglob("*.csv")) == before and not (house / "all").exists()


def test_archive_that_is_not_mounted_is_told(house: Path, tmp_path: Path) -> None:
    text = (house / "hub.toml").read_text().replace('"archive"', f'"{tmp_path}"')
    (house / "unmounted.toml").write_text(text)
    with pytest.raises(InputError, match=f"^archives: {tmp_path}: found no archive, expected one"):
        query(house / "unmounted.toml", "SELECT count(*) FROM poses", archives=True)


def test_question_about_archives_has_limits(house: Path) -> None:
    found = load_hub(house)
    with pytest.raises(InputError, match="more than 10 rows"):
        answer_of_archives(found, "SELECT * FROM poses", "me", most_rows=10)
    with pytest.raises(InputError, match=r"took more than 0\.5 s"):
        endless = "SELECT sum(a.range * b.range) FROM range(10000000) a, range(10000000) b"
        answer_of_archives(found, endless, "me", limit_s=0.5)
    for greedy in ("SELECT length(repeat('x', 3000000000))", "SELECT len(range(1000000000))"):
        with pytest.raises(InputError, match=r"query: .*([Mm]emory|alloc)"):
            answer_of_archives(found, greedy, "me", most_bytes=1_000_000_000)


def test_hours_are_the_sums_of_summaries_however_they_came(tmp_path: Path) -> None:
    whole, parts = (open_hub(str(tmp_path / name)) for name in ("whole.db", "parts.db"))
    rows = [*records_of(1, 600, 200)]
    keep(whole, "lab", rows, Cursor(1, 800), 1)
    for at in range(0, 200, 7):
        keep(parts, "lab", rows[max(at - 3, 0) : at + 7], Cursor(1, 800), 1)  # some twice
    asked = "SELECT * FROM hours ORDER BY time_ns"
    with whole.connect() as one, parts.connect() as other:
        found = [tuple(row) for row in one.exec_driver_sql(asked)]
        assert found == [tuple(row) for row in other.exec_driver_sql(asked)]
        (total,) = one.exec_driver_sql("SELECT sum(people * span_s) / 3600 FROM summaries").one()
    assert sum(row[5] for row in found) == pytest.approx(total)
    assert {row[1] % (3600 * 10**9) for row in found} == {BEGIN_NS % (3600 * 10**9)}
