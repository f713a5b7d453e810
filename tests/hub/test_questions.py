"""Questions over weeks of several sites: the page's seven, and tables in a terminal."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pandas
import pytest
from tests.cli.commands import run as run_verb
from tests.postgres import DATABASE, USER, Server

from e3pose.base.errors import InputError
from e3pose_hub import database as hub_database
from e3pose_hub.database import HOUR_NS, MOST_READ, Cursor, keep, open_hub, read_rows
from e3pose_hub.frames import query
from e3pose_hub.settings import load_hub
from simulated_sites import BEGIN_NS, CAMERAS, records_of, summaries_of

pytestmark = pytest.mark.slow

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "ask-many-sites.md"
SITES = {"lab": "clinics", "hall": "clinics", "gym": "sports"}
DAYS = 4
MINUTES = 1440 * DAYS


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a hub with days of two weeks of three sites."""
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
    found = re.findall(r"^### ([^\n]*)\n\n```python\n(.*?)```", PAGE.read_text(), re.M | re.S)
    assert len(found) == 7
    return dict(found)


def answers(house: Path | str) -> dict[str, Any]:
    """Return what the page's code says of a hub, by heading."""
    tables = {name: query(house, name) for name in ("hours", "summaries")}
    found = {}
    for heading, code in questions().items():
        names: dict[str, Any] = {"pandas": pandas, **tables}
        exec(code, names)
        found[heading] = names["answer"]
    return found


def test_answers_are_those_of_what_was_made(house: Path) -> None:
    said = answers(house)
    made = {site: [*summaries_of(at, 0, MINUTES)] for at, site in enumerate(SITES)}
    falls = {
        site: sum(json.loads(row["events"]).get("fall begun", 0) for row in rows)
        for site, rows in made.items()
    }
    weeks = said["How many falls were there, by week?"]
    assert weeks.groupby("site").sum().to_dict() == falls and min(falls.values()) > 0
    assert len(weeks) > len(SITES)
    kitchen = sum(json.loads(row["zones"]).get("kitchen", 0) for row in made["gym"]) / 60
    stays = said["How long do people stay where?"]
    assert stays.loc["gym", "kitchen"] == pytest.approx(kitchen)
    watts = said["How many watts does each site draw, and how much of it is measured?"]
    assert watts.watts.tolist() == pytest.approx([2 * 6 + 2 * 3] * 3)
    assert watts.measured.tolist() == pytest.approx([0.5] * 3)
    slots = sum(sum(json.loads(row["blind"]).values()) for row in made["hall"])
    blind = said["Where did cameras see nothing?"].blind
    assert blind["hall"] == pytest.approx(slots / (MINUTES * 1500))
    low = said["Which cameras are lost often, and whose battery runs low?"].loc["lab"]
    minutes = [f"camera-lost {CAMERAS[2]}" in json.loads(row["faults"]) for row in made["lab"]]
    assert low["camera-lost cam3"] == sum(minutes) > 0
    charge = [json.loads(row["charge"])[CAMERAS[0]] for row in made["lab"]]
    assert low[CAMERAS[0]] == pytest.approx(min(charge))
    assert said["Was anybody there at night?"].empty
    busiest = said["When is each site busiest?"]
    assert all(8 <= hour < 18 for _, hour in busiest.index) and busiest.index[0][0] == "gym"


def test_a_site_and_a_time_choose_rows(
    house: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = query(house, "hours")
    assert len(whole) == len(SITES) * DAYS * 24 and query(house, "sites").site.tolist() == [
        *sorted(SITES)
    ]
    begin = whole.time_ns.min()
    some = query(
        house, "hours", site="gym", start=int(begin) + HOUR_NS, end=int(begin) + 4 * HOUR_NS
    )
    assert some.time_ns.tolist() == [begin + hour * HOUR_NS for hour in (1, 2, 3)]
    path, moment = tmp_path / "hours.csv", some.time[0].isoformat()
    words = ("hours", "--site", "gym", "--from", moment, "--csv", path)
    assert run_verb("hub", "query", house, *words) == 0
    lines = path.read_text().splitlines()
    assert len(lines) == DAYS * 24 and lines[0].startswith("site,time_ns,span_s,slots,blind")
    assert all(line.startswith("gym,") for line in lines[1:])
    capsys.readouterr()
    for wrong, why in (
        (("sites", "--from", "-1d"), "--from: found '-1d', expected a time of summaries or hours"),
        (("hours", "--to", "12.5"), "--to: found '12.5', expected a time of summaries or hours"),
        (("hours", "--from", "soon"), "--from, --to: found 'soon'"),
        (("summaries",), f"summaries: found more than {MOST_READ} rows, expected one site"),
        (("DROP TABLE hours",), "DROP TABLE hours"),
        (("people",), "people"),
    ):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(hub_database, "MOST_READ", 1000)
            assert run_verb("hub", "query", house, *wrong) == 2
        said = " ".join(capsys.readouterr().err.split())
        assert why.replace(str(MOST_READ), "1000") in said, said
    assert run_verb("hub", "query", house, "sites") == 0
    assert all(site in capsys.readouterr().out for site in ("gym",))


def test_rows_are_the_same_in_postgresql(tmp_path: Path, postgres: Server) -> None:
    found = []
    for database in (str(tmp_path / "hub.db"), postgres.new_hub()):
        engine = open_hub(database)
        for at, site in enumerate(SITES):
            keep(engine, site, [*records_of(at, 0, 300)], Cursor(1, 300), 1)
        engine.dispose()
        found.append([read_rows(database, table, end=2**60) for table in ("summaries", "hours")])
        assert read_rows(database, "sites", "lab")[1] == [("lab", 1, 300, 0, 1, "")]
    assert found[0] == found[1]


def test_file_of_a_hub_that_names_archives_is_read_for_a_release(tmp_path: Path) -> None:
    (tmp_path / "hub.toml").write_text('format = "e3pose-hub"\nversion = 1\narchives = ["a"]')
    assert load_hub(tmp_path).archives == ("a",)


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
        for use in (open_hub, lambda url: read_rows(url, "sites")):
            with pytest.raises(InputError, match=rf"role {role} with {right}.*CREATE ROLE"):
                use(database)
        postgres.run("psql", "-U", USER, "-d", DATABASE, "-c", back.format(role))
    assert read_rows(database, "sites")[1] == []
