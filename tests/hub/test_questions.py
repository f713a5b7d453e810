"""Questions over a month of several sites: the page's seven, in a terminal and in Python."""

from __future__ import annotations

import json
import re
import time
from pathlib import Path

import pytest
from tests.cli.commands import run as run_verb
from tests.postgres import DATABASE, USER, Server

from e3pose.base.errors import InputError
from e3pose_hub import accesses as log
from e3pose_hub.accesses import log_accesses, read_accesses
from e3pose_hub.database import Cursor, keep, open_hub
from e3pose_hub.frames import query
from e3pose_hub.question import answer
from e3pose_hub.settings import load_hub
from simulated_sites import (
    BEGIN_NS,
    CAMERAS,
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
    """Make a hub with a month of three sites."""
    folder = tmp_path_factory.mktemp("house")
    lines = ['format = "e3pose-hub"', "version = 1"]
    for at, (site, group) in enumerate(SITES.items()):
        lines += ["[[site]]", f'name = "{site}"', f'group = "{group}"']
        lines.append(f'endpoint = "tcp/127.0.0.1:{7000 + at}"')
    (folder / "hub.toml").write_text("\n".join(lines))
    engine = open_hub(str(folder / "hub.db"))
    for at, site in enumerate(SITES):
        keep(engine, site, [*records_of(at, 0, MINUTES)], Cursor(1, MINUTES), 1)
    return folder


def questions() -> dict[str, str]:
    """Return the questions of the page by their heading."""
    found = re.findall(r"^### ([^\n]*)\n\n```sql\n(.*?)```", PAGE.read_text(), re.M | re.S)
    assert len(found) == 7
    return dict(found)


def ask(house: Path, heading: str) -> list[tuple[object, ...]]:
    return list(query(house, questions()[heading]).itertuples(index=False, name=None))


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
    databases = str(tmp_path / "hub.db"), postgres.new_hub()
    for database in databases:
        engine = open_hub(database)
        for at, site in enumerate(SITES):
            keep(engine, site, [*records_of(at, 0, 2000)], Cursor(1, 2000), 1)
        engine.dispose()
    for heading, sql in questions().items():
        mine, yours = (
            sorted(answer(database, words)[1], key=str)
            for database, words in zip(databases, (sql, in_postgresql(sql)), strict=True)
        )
        assert len(mine) == len(yours), heading
        for row, other in zip(mine, yours, strict=True):
            assert row[0] == other[0], heading
            assert float(row[-1]) == pytest.approx(float(other[-1])), heading


def test_question_about_archives_says_what_to_do_instead(
    house: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in (["--archives"], ["--group", "sports"]):
        assert run_verb("hub", "query", house, "SELECT count(*) FROM poses", *words) == 2
        said = capsys.readouterr().err
        assert "no longer reads archives: open their Parquet files in DuckDB, Polars" in said
        assert (PAGE.parents[2] / said.split()[-2]).is_file(), "it names a page"


def test_file_of_a_hub_that_names_archives_is_read_for_a_release(tmp_path: Path) -> None:
    (tmp_path / "hub.toml").write_text('format = "e3pose-hub"\nversion = 1\narchives = ["a"]')
    assert load_hub(tmp_path).archives == ("a",)


def test_log_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log, "MOST", 5)
    monkeypatch.setattr(log, "SPARE", 1)
    engine = open_hub(str(tmp_path / "hub.db"))
    for number in range(9):
        log_accesses(engine, f"user{number}", ["lab"], "x" * 1000)
    found = read_accesses(str(tmp_path / "hub.db"))
    assert [one.who for one in found] == [f"user{number}" for number in (8, 7, 6, 5, 4)]
    assert len(found[0].what) == 500


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


ENDLESS = {
    # One step of SQLite that never yields: it looks at no clock within it.
    "file": "SELECT instr(hex(zeroblob(4900000)), hex(zeroblob(2400000)) || 'x')",
    "server": "SELECT pg_sleep(60), count(*) FROM summaries",
}


@pytest.mark.parametrize("kind", sorted(ENDLESS))
def test_question_without_an_end_is_ended(
    tmp_path: Path, kind: str, request: pytest.FixtureRequest
) -> None:
    database = str(tmp_path / "hub.db")
    if kind == "server":
        database = request.getfixturevalue("postgres").new_hub()
    open_hub(database).dispose()
    begun_s = time.monotonic()
    with pytest.raises(InputError, match=r"took more than|statement timeout"):
        answer(database, ENDLESS[kind], limit_s=1.0)
    assert time.monotonic() - begun_s < 15.0


def test_slow_question_is_answered(tmp_path: Path) -> None:
    """Longer than after two seconds, when a database may begin to show its progress."""
    database = str(tmp_path / "hub.db")
    open_hub(database).dispose()
    counting = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < {})"
    begun_s, most = time.monotonic(), 2_000_000
    while time.monotonic() - begun_s < 2.5:
        begun_s, most = time.monotonic(), 2 * most
        asked = f"{counting.format(most)} SELECT count(*), 0.5, 'å', NULL FROM n"
        assert answer(database, asked)[1] == [[most, 0.5, "å", None]]


def test_large_answer_of_a_server_is_refused_within_the_limit(postgres: Server) -> None:
    database = postgres.new_hub()
    open_hub(database).dispose()
    begun_s = time.monotonic()
    with pytest.raises(InputError, match="more than 100000000 bytes"):
        answer(database, "SELECT repeat('x', 1000000) FROM generate_series(1, 150)")
    assert time.monotonic() - begun_s < 20.0


def test_server_runs_nothing_but_one_select(postgres: Server) -> None:
    database = postgres.new_hub()
    engine = open_hub(database)
    keep(engine, "lab", [*records_of(0, 0, 5)], Cursor(1, 5), 1)
    engine.dispose()
    for asked in (
        "DO $$ BEGIN COMMIT; SET TRANSACTION READ WRITE; DELETE FROM summaries; COMMIT; END $$",
        "COPY summaries TO '/tmp/all'",
        "SELECT 1; DELETE FROM summaries",
        "SELECT 1) TO '/tmp/all' --",
        "WITH gone AS (DELETE FROM summaries RETURNING 1) SELECT * FROM gone",
        "SELECT query_to_xml('DELETE FROM summaries', true, true, '')",
        "SELECT pg_read_file('/etc/passwd')",
    ):
        with pytest.raises(InputError, match="query: "):
            answer(database, asked)
    assert answer(database, "SELECT count(*) FROM summaries;")[1] == [[5]]
    assert answer(database, "SELECT site, taken AS t FROM sites WHERE false") == (["site", "t"], [])


def test_role_with_more_rights_than_a_hub_needs_is_refused(postgres: Server) -> None:
    database = postgres.new_hub()
    open_hub(database).dispose()
    role = database.partition("//")[2].partition("@")[0]
    for grant, back, right in (
        ("ALTER ROLE {} SUPERUSER", "ALTER ROLE {} NOSUPERUSER", "SUPERUSER"),
        ("ALTER ROLE {} CREATEROLE", "ALTER ROLE {} NOCREATEROLE", "CREATEROLE"),
        (
            "GRANT pg_write_server_files TO {}",
            "REVOKE pg_write_server_files FROM {}",
            "pg_write_server_files",
        ),
    ):
        postgres.run("psql", "-U", USER, "-d", DATABASE, "-c", grant.format(role))
        for use in (open_hub, lambda url: answer(url, "SELECT 1")):
            with pytest.raises(InputError, match=rf"role {role} with {right}.*CREATE ROLE"):
                use(database)
        postgres.run("psql", "-U", USER, "-d", DATABASE, "-c", back.format(role))
    assert answer(database, "SELECT 1 AS one") == (["one"], [[1]])
