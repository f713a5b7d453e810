"""Users of a hub at the page of a site: edge, page, hub and its page, each a program of its own."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from tests.cli.commands import run
from tests.hub.test_hub import E3POSE, program
from tests.live.processes import LiveSite, make_recording
from tests.ports import free_port
from tests.waiting import eventually
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from e3pose.wire.keys.folder import add_keys

HUB = """
format = "e3pose-hub"
version = 1
every_s = 1
[view]
listen = "127.0.0.1:{port}"
[[site]]
name = "lab"
endpoint = "tls/localhost:{edge}"
keys = "{keys}"
group = "clinics"
page = "{page}"
page_users = true
"""
# Behind a proxy, reading needs a token on loopback too.
VIEW = ["[view]", 'hubs = ["house"]', 'proxies = ["127.0.0.1"]', "[store]", 'path = "poses.db"']


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


@contextmanager
def followed(page: str, token: str) -> Iterator[ClientConnection]:
    """Follow the slots of a page."""
    url = f"{page.replace('http', 'ws')}api/live"
    headers = bearer(token)  # the server alone ends it
    with connect(url, additional_headers=headers, open_timeout=20, ping_interval=None) as following:
        following.recv(20)
        yield following


def test_right_at_a_hub_opens_a_site_and_ends_there_when_it_is_revoked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    house = tmp_path / "house"
    house.mkdir()
    (tmp_path / "site").mkdir()
    make_recording(tmp_path / "site" / "recording")
    with LiveSite(tmp_path / "site", tables=VIEW).at_work() as site:
        keys = site.folder / "keys"
        add_keys(keys, "house", datetime.datetime.now(datetime.timezone.utc), kind="hub")
        page, port = site.start_view(), free_port()
        text = HUB.format(port=port, edge=site.port, keys=keys / "hubs" / "house", page=page)
        (house / "hub.toml").write_text(text)
        capsys.readouterr()
        tokens = {}
        for user, role in (("ada", "--operator"), ("bob", "--viewer")):
            assert run("hub", "grant", house, user, role, "--group", "clinics") == 0
            tokens[user] = capsys.readouterr().out.split()[2]

        def own(user: str) -> httpx.Response:
            """Ask the hub's page for the way to the site's own page."""
            return httpx.post(
                f"http://127.0.0.1:{port}/api/open", json={"site": "lab"},
                headers=bearer(tokens[user]),
            )  # fmt: skip

        def status(token: str) -> int:
            return httpx.get(f"{page}api/status", headers=bearer(token), timeout=20).status_code

        def controls(token: str) -> int:
            asked = {"kind": "cameras", "count": 2}
            url = f"{page}api/control"
            return httpx.post(url, json=asked, headers=bearer(token), timeout=20).status_code

        with (
            program(*E3POSE, "hub", "run", str(house)),
            program(*E3POSE, "hub", "view", str(house)),
        ):
            assert eventually(lambda: own("ada").status_code == 200)
            ways = {user: own(user).json()["url"].split("#token=") for user in tokens}
            assert {way[0] for way in ways.values()} == {page}
            ada, bob = (ways[user][1] for user in ("ada", "bob"))
            assert eventually(lambda: status(ada) == status(bob) == 200, 60), site.diagnostics()
            assert status(tokens["ada"]) == 401, "her token at the hub is none of the site"
            assert controls(bob) == 403 and controls(ada) != 403
            with followed(page, ada) as hers, followed(page, bob) as his:
                assert run("hub", "revoke", house, "ada") == 0
                assert own("ada").status_code == 401, "at once at the hub"

                def ended() -> bool:
                    try:
                        hers.recv(5)
                    except ConnectionClosed:
                        return True
                    return False

                assert eventually(ended, 60), "what was open ends too"
                his.recv(20)
            assert status(ada) == 401 and controls(ada) == 401
            assert status(bob) == 200
            assert run("hub", "grant", house, "ada", "--viewer", "--group", "clinics") == 0
            assert status(ada) == 401, "a new right is a new token"
            tokens["ada"] = capsys.readouterr().out.split()[-1].partition("=")[2]
            again = own("ada").json()["url"].partition("=")[2]
            assert eventually(lambda: status(again) == 200, 60)
            assert controls(again) == 403
