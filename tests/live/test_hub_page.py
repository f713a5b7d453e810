"""The page over sites in a real browser: who sees which sites, how they are, and how it looks."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import msgspec
import numpy as np
import pytest
from tests.site.web.browser import Page, in_browser
from tests.waiting import eventually

from e3pose.site.web.server import PageServer
from e3pose.store.summaries import MINUTE_NS
from e3pose_hub.accesses import read_accesses
from e3pose_hub.database import Cursor, keep, note_problem, open_hub
from e3pose_hub.page import open_page
from e3pose_hub.settings import load_hub
from e3pose_hub.users import Users, grant, revoke, users_of
from simulated_sites import records_of

pytestmark = in_browser
SITES = {"lab": "clinics", "hall": "clinics", "gym": "sports", "pool": "sports", "vault": "other"}
OPEN_AT = 12 * 60  # a minute of the made-up day at which people are there


@dataclass
class House:
    """A hub with a page, and the tokens of its users."""

    folder: Path
    view: PageServer
    ada: str  # operator of clinics and sports
    bob: str  # viewer of clinics


def charged(minute: int) -> float:
    """Return what is left of a battery that empties by 0.6 in a day, from full at midnight."""
    return 1 - (OPEN_AT + minute) / 1440 * 0.6


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Iterator[House]:
    """Lab is well, hall has faults, gym is blind, pool is silent; vault is of another group."""
    folder = tmp_path_factory.mktemp("house")
    lines = ['format = "e3pose-hub"', "version = 1"]
    for at, (site, group) in enumerate(SITES.items()):
        lines += ["[[site]]", f'name = "{site}"', f'group = "{group}"']
        lines += [f'endpoint = "tcp/127.0.0.1:{7000 + at}"']
        if site != "gym":
            lines += [f'page = "https://127.0.0.1:{8000 + at}/"', "page_users = true"]
    (folder / "hub.toml").write_text("\n".join(lines))
    engine, hub = open_hub(str(folder / "hub.db")), load_hub(folder)
    now_ns = time.time_ns()
    newest_ns = now_ns - now_ns % MINUTE_NS - MINUTE_NS
    change: dict[str, dict[str, Any]] = {
        "lab": {"faults": [], "blind": {}},
        "hall": {"faults": ["camera-lost cam2", "store-full"], "blind": {}},
        "gym": {"faults": [], "blind": {"views-late": 300}},
        "vault": {"faults": [], "blind": {}},
    }
    for at, site in enumerate(SITES):
        rows = [
            msgspec.structs.replace(
                row,
                time_ns=newest_ns - (119 - number) * MINUTE_NS,
                charge=dict.fromkeys(row.charge, charged(number)),
                **change.get(site, {}),
            )
            for number, row in enumerate(records_of(at, OPEN_AT, 120))
        ]
        fall = msgspec.structs.replace(rows[60], events={"fall begun": 2, "camera-lost": 1})
        keep(engine, site, [] if site == "pool" else [*rows[:60], fall, *rows[61:]],
             Cursor(1, 120), now_ns - (3 * 3600 * 10**9 if site == "pool" else 0))  # fmt: skip
    note_problem(engine, "pool", "pool: no answer")
    ada = grant(hub, "ada", "operator", ("clinics", "sports"))
    bob = grant(hub, "bob", "viewer", ("clinics",))
    with open_page(hub, "127.0.0.1:0") as view:
        yield House(folder, view, ada, bob)


def see(page: Page, house: House, token: str, *size: int) -> None:
    """Open the page over sites as somebody."""
    page.open(house.view.url + f"#token={token}", *size)
    assert eventually(lambda: page.run("document.querySelector('#table') !== null"))


def row(page: Page, site: str) -> str:
    """Return the text of the row of a site; empty where it is not shown."""
    rows = "[...document.querySelectorAll('#table tr')].filter((r) => r.cells[0].textContent === "
    return str(page.run(f"{rows}{json.dumps(site)}).map((r) => r.innerText).join('')"))


def test_each_site_is_shown_as_it_is(page: Page, house: House) -> None:
    see(page, house, house.ada)
    assert page.shows("state", "3 to look at")
    assert "well" in row(page, "lab") and "18.0 W" in row(page, "lab")
    assert "fall × 2" in row(page, "lab") and "camera" not in row(page, "lab")
    assert "trouble" in row(page, "hall") and "cam2 lost, disk full" in row(page, "hall")
    assert "20 % of its slots blind" in row(page, "gym") and "no page" in row(page, "gym")
    assert "silent" in row(page, "pool") and "\tno answer, answered 3 h ago" in row(page, "pool")
    assert row(page, "vault") == "" and "vault" not in page.text("page")
    assert "1 of 2" in row(page, "clinics") and "36.0 W" in row(page, "clinics")
    assert page.run("document.querySelector('#figures').innerText").count("4\n") >= 1
    assert page.messages == []


def test_hours_left_are_those_of_the_battery_that_drains_fastest(page: Page, house: House) -> None:
    see(page, house, house.ada)
    charge = charged(119)  # 0.65 are left at 14:00
    hours = round(charge / (0.6 / 24))
    assert f"{hours} h" in row(page, "hall") and f"{round(100 * charge)} %" in row(page, "hall")


def test_words_group_and_trouble_choose_sites(page: Page, house: House) -> None:
    see(page, house, house.ada)
    page.run("document.getElementById('trouble').click()")
    assert eventually(lambda: row(page, "lab") == "") and row(page, "hall")
    page.run(
        "(() => { const find = document.getElementById('find'); find.value = 'PO';"
        " find.dispatchEvent(new Event('input', { bubbles: true })); })()"
    )
    assert eventually(lambda: row(page, "hall") == "") and row(page, "pool")


def test_way_to_a_site_s_own_page_is_with_the_rights_one_has_and_logged(
    page: Page, house: House
) -> None:
    see(page, house, house.bob)
    assert page.run("document.querySelector('td.go button').textContent") == "See"
    for name, token in (("ada", house.ada), ("bob", house.bob)):
        asked = httpx.post(
            house.view.url + "api/open", json={"site": "lab"},
            headers={"Authorization": f"Bearer {token}"},
        )  # fmt: skip
        users = Users(users_of(load_hub(house.folder)).path).all()
        own = next(user for user in users if user.name == name).page_token("lab")
        assert asked.json() == {"url": f"https://127.0.0.1:8000/#token={own}"}
        newest = read_accesses(str(house.folder / "hub.db"), limit=1)[0]
        assert (newest.who, newest.site) == (name, "lab")
        assert newest.what == f"live page, to {'control' if name == 'ada' else 'see'}"
    page.run("document.querySelector('td.go button').click()")
    database = str(house.folder / "hub.db")
    assert eventually(lambda: read_accesses(database, limit=1)[0].site == "hall")
    assert eventually(lambda: house.view.url not in page.run("location.href"))  # nothing is there
    page.messages.clear()


def test_others_get_nothing(page: Page, house: House) -> None:
    before = len(read_accesses(str(house.folder / "hub.db")))

    def status(path: str, token: str, site: str = "") -> int:
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        url = house.view.url + path
        asked = httpx.post(url, json={"site": site}, headers=headers) if site else httpx.get(
            url, headers=headers
        )  # fmt: skip
        return asked.status_code

    assert status("api/sites", "") == 401 and status("api/sites", "wrong-wrong-wrong-wrong") == 401
    assert [status("api/open", house.bob, site) for site in ("gym", "vault", "../lab")] == [404] * 3
    assert status("api/open", house.ada, "gym") == 409, "it has no page"
    gone = grant(load_hub(house.folder), "eve", "viewer", ("clinics",))
    assert status("api/sites", gone) == 200
    revoke(load_hub(house.folder), "eve")
    assert status("api/sites", gone) == 401
    assert len(read_accesses(str(house.folder / "hub.db"))) == before
    page.open(house.view.url + "#token=wrong-wrong-wrong-wrong")
    assert page.shows("state", "no access") and "lab" not in page.text("page")
    page.run("sessionStorage.clear()")


def test_axe_finds_nothing_serious_and_nothing_is_cut_off(page: Page, house: House) -> None:
    see(page, house, house.ada)
    assert np.ptp(page.picture()) > 100
    page.judge()
