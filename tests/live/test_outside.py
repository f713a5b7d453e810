"""A site of real processes over TLS from outside: its page, users of a hub, routers, a new camera.

Its edge dies and comes back at the end.
"""

from __future__ import annotations

import datetime
import json
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import httpx
import pytest
import zenoh
from tests.cli.commands import run
from tests.hub.test_hub import E3POSE, program
from tests.live.processes import CAMERAS, LiveSite, e3pose
from tests.ports import free_port
from tests.site.web.browser import Page, in_browser
from tests.waiting import WAIT_S, eventually
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from e3pose.site.web.tokens import open_tokens
from e3pose.wire.access import Link, zenoh_config
from e3pose.wire.codec import encode
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import add_keys, certificates_in, revoke_keys
from e3pose.wire.network import NetworkTransport, open_network
from e3pose.wire.site_messages import OutboxQuestion
from e3pose.wire.topics import of_outbox

HUB = """
format = "e3pose-hub"
version = 1
every_s = 1
[view]
listen = "127.0.0.1:{port}"
[[site]]
name = "{site}"
endpoint = "tls/localhost:{edge}"
keys = "{keys}"
group = "clinics"
page = "{page}"
page_users = true
"""
# Behind a proxy, reading needs a token on loopback too, and pictures that they are allowed.
VIEW = [
    "[view]", 'hubs = ["house"]', 'proxies = ["127.0.0.1"]', "pictures = true",
    "[store]", 'path = "poses.db"',
]  # fmt: skip
GONE_S = 20.0  # three seconds of silence, on a machine that does other things


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[LiveSite]:
    folder, port = tmp_path_factory.mktemp("site"), free_port()
    (folder / "recording").symlink_to(recording)
    # Cameras that join look for a site by its name: not for that of another test.
    name = f"join-{port}"
    options = ["--pictures"]  # and few slots: none of these tests looks at how many there are
    made = LiveSite(folder, port=port, tables=VIEW, camera_options=options, name=name, fps=10.0)
    with made.at_work():
        now, keys = datetime.datetime.now(datetime.timezone.utc), folder / "keys"
        add_keys(keys, "house", now, kind="hub")
        add_keys(keys, "hall", now, kind="router")
        yield made


@pytest.fixture(scope="module")
def url(site: LiveSite) -> str:
    """The address of the page, which is started with an operator's certificate."""
    return site.start_view()


def token_of(site: LiveSite, kind: Literal["read", "write"] = "write") -> str:
    return str(getattr(open_tokens(site.folder / "view-tokens.toml"), kind))


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def client_of(site: LiveSite, url: str) -> httpx.Client:
    return httpx.Client(base_url=url, timeout=30, headers=bearer(token_of(site)))


@in_browser
def test_page_shows_all_cameras_and_enlarges_one(site: LiveSite, url: str, page: Page) -> None:
    page.open(f"{url}#token={token_of(site)}")
    assert page.shows("state", "live")
    shown = "[...m.tiles.values()].filter((one) => one.image && one.found.people.length).length"
    assert eventually(lambda: page.of("pictures", shown) == len(CAMERAS)), page.text("tiles")
    page.run("document.querySelectorAll('.tile')[1].focus()")
    page.press("Enter")
    assert page.shows("large-of", "cam1") and page.run("document.getElementById('large').open")
    # The camera makes a larger one, also of the image that it has shown already.
    assert eventually(lambda: page.of("pictures", "m.tiles.get('cam1').image.width > 320"))
    assert page.shows("large-said", "poses of slot")
    page.run("document.getElementById('large-off').click()")
    assert not page.run("document.getElementById('large').open")
    assert page.messages == []


# Routers upstream hold the declarations of all sites, and liveliness grows with the square of them.
MOST_KEYS = 4
Kind = Literal["hub", "viewer", "router"]
KINDS = "subscriber", "queryable", "publisher", "querier", "token"


@contextmanager
def router(site: LiveSite, kind: Kind, name: str) -> Iterator[Any]:
    """Be a router of Zenoh's own kind, which is connected to the edge, and says what it holds."""
    files = certificates_in(site.folder / "keys" / f"{kind}s" / name, kind)
    config = zenoh_config(Link("viewer", site.name, read_endpoint(site.endpoint), files))
    config["mode"] = "router"
    config["adminspace"] = {"enabled": True, "permissions": {"read": True, "write": False}}
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session:
        assert eventually(lambda: list(session.info.routers_zid()))
        yield session


@contextmanager
def hub(site: LiveSite) -> Iterator[NetworkTransport]:
    """Join as a hub does, for one question."""
    files = certificates_in(site.folder / "keys" / "hubs" / "house", "hub")
    transport = open_network(Link("viewer", site.name, read_endpoint(site.endpoint), files))
    try:
        yield transport
    finally:
        transport.close()


def held(session: Any, what: str) -> set[str]:
    """Return the keys that a router holds of a kind of declaration."""
    prefix = f"@/{session.zid()}/router/{what}/"
    found = [r.ok for r in session.get(f"{prefix}**") if r.ok is not None]
    return {str(sample.key_expr).removeprefix(prefix) for sample in found}


def all_held(session: Any) -> set[str]:
    return {key for what in KINDS for key in held(session, what) if not key.startswith("@")}


def test_hub_s_router_holds_no_key_and_no_token(site: LiveSite) -> None:
    with router(site, "hub", "house") as session:
        with hub(site) as transport:  # which this certificate is for
            topic = of_outbox(site.name, "house")
            assert eventually(lambda: transport.ask(topic, encode(OutboxQuestion()), 5.0))
            site.flows(20)  # cameras, viewer and edge say what they have to say
        assert all_held(session) == set()


def test_viewer_s_router_holds_four_fixed_keys_at_most(site: LiveSite) -> None:
    own = {f"e3pose/{site.name}/{what}" for what in ("poses", "poses-delayed", "status", "alive")}
    with router(site, "viewer", "wall") as session:
        assert eventually(lambda: held(session, "token"))
        site.flows(20)
        found = all_held(session)
        assert found <= own and len(found) <= MOST_KEYS
        assert held(session, "token") == {f"e3pose/{site.name}/alive"}


def test_router_of_the_site_itself_holds_more(site: LiveSite) -> None:
    """What the others do not hold is there to be held, and would be seen."""
    with router(site, "router", "hall") as session:
        assert eventually(lambda: any("*" in key for key in held(session, "subscriber")))
        assert eventually(lambda: len(held(session, "token")) > 1)
        assert len(all_held(session)) > MOST_KEYS


# Users of a hub at the page of the site: the hub and its page are programs of their own.


@contextmanager
def followed(page: str, token: str) -> Iterator[ClientConnection]:
    """Follow the slots of a page."""
    url = f"{page.replace('http', 'ws')}api/live"
    headers = bearer(token)  # the server alone ends it
    with connect(url, additional_headers=headers, open_timeout=20, ping_interval=None) as following:
        following.recv(20)
        yield following


def test_right_at_a_hub_opens_a_site_and_ends_there_when_it_is_revoked(
    site: LiveSite, url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    house, keys, port = tmp_path, site.folder / "keys" / "hubs" / "house", free_port()
    text = HUB.format(port=port, edge=site.port, keys=keys, page=url, site=site.name)
    (house / "hub.toml").write_text(text)
    capsys.readouterr()
    tokens = {}
    for user, role in (("ada", "--operator"), ("bob", "--viewer")):
        assert run("hub", "grant", house, user, role, "--group", "clinics") == 0
        tokens[user] = capsys.readouterr().out.split()[2]

    def own(user: str) -> httpx.Response:
        """Ask the hub's page for the way to the site's own page."""
        return httpx.post(
            f"http://127.0.0.1:{port}/api/open", json={"site": site.name},
            headers=bearer(tokens[user]),
        )  # fmt: skip

    def status(token: str) -> int:
        return httpx.get(f"{url}api/status", headers=bearer(token), timeout=20).status_code

    def controls(token: str) -> int:
        asked = {"kind": "cameras", "count": 2}
        return httpx.post(
            f"{url}api/control", json=asked, headers=bearer(token), timeout=20
        ).status_code

    with (
        program(*E3POSE, "hub", "run", str(house)),
        program(*E3POSE, "hub", "view", str(house)),
    ):
        assert eventually(lambda: own("ada").status_code == 200)
        ways = {user: own(user).json()["url"].split("#token=") for user in tokens}
        assert {way[0] for way in ways.values()} == {url}
        ada, bob = (ways[user][1] for user in ("ada", "bob"))
        assert eventually(lambda: status(ada) == status(bob) == 200, 60), site.diagnostics()
        assert status(tokens["ada"]) == 401, "her token at the hub is none of the site"
        assert controls(bob) == 403 and controls(ada) != 403
        with followed(url, ada) as hers, followed(url, bob) as his:
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


# A new camera joins by a code.


def join(
    site: LiveSite, folder: Path, code: str, *options: str
) -> subprocess.CompletedProcess[str]:
    """Run the camera program on another machine, so to say, and type a code there."""
    folder.mkdir(exist_ok=True)
    words = ["camera", "--join", "--name", "cam2", "--site", site.name, "--meter", "model"]
    source = f"recorded:{site.folder / 'recording'}"
    return subprocess.run(
        [*e3pose(*words), "--source", source, *options],
        input=f"{code}\n",
        capture_output=True,
        text=True,
        cwd=folder,
        timeout=60,
    )


def shown_code(page: Page) -> str:
    """Press the button of the page, as soon as it can be; return the code that it shows."""
    free = "!document.getElementById('join-button').disabled"
    assert eventually(
        lambda: page.run(f"{free} && !document.getElementById('join-button').click()")
    )
    assert eventually(lambda: page.run("!!document.getElementById('join-code')"))
    return str(page.text("join-code"))


@in_browser
def test_camera_joins_by_the_code_of_the_page_and_works_at_once(
    site: LiveSite, url: str, page: Page, tmp_path: Path
) -> None:
    site.without("cam2")
    revoke_keys(site.folder / "keys", "cam2")
    shutil.rmtree(site.folder / "keys" / "cameras" / "cam2", ignore_errors=True)
    page.messages.clear()
    page.open(f"{url}#token={token_of(site)}")
    assert page.shows("join", "Without a certificate: cam2.")
    code = shown_code(page)
    page.judge("document.getElementById('join')")
    for token, status in (("", 401), (token_of(site, "read"), 403)):  # the code is for operators
        headers = bearer(token) if token else {}
        assert httpx.get(f"{url}api/control/join", headers=headers).status_code == status
    wrong = join(site, tmp_path / "pi", "000 001" if code == "000 000" else "000 000")
    assert wrong.returncode == 2 and "wrong code" in wrong.stderr, wrong
    assert not any((tmp_path / "pi").iterdir())
    assert page.shows("join-said", "The code is used up, by 127.0.0.1: wrong code")
    done = join(site, tmp_path / "pi", shown_code(page))
    assert done.returncode == 0, done.stderr
    assert "cam2 joined" in done.stdout and "next: e3pose camera cam2.toml" in done.stdout
    assert page.shows("join-said", "cam2 joined.")
    assert page.shows("join", "All cameras of the site have certificates.")
    assert (tmp_path / "pi" / "cam2" / "camera.key").stat().st_mode & 0o777 == 0o600
    assert not (site.folder / "keys" / "cameras" / "cam2" / "camera.key").exists()
    site.start("cam2", *e3pose("camera", str(tmp_path / "pi" / "cam2.toml")))
    site.becomes("cam0", "cam1", "cam2")
    assert [one for one in page.messages if "40" not in one] == []


def test_camera_joins_by_a_terminal_of_the_edge(site: LiveSite, tmp_path: Path) -> None:
    revoke_keys(site.folder / "keys", "cam2")
    site.becomes("cam0", "cam1")
    words = e3pose("keys", "join", str(site.path))
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as door:
        assert door.stdout is not None
        code = door.stdout.readline().rpartition(":")[2].strip()
        done = join(site, tmp_path / "pi", code, "--endpoint", site.endpoint)
        assert done.returncode == 0, done.stderr
        assert "cam2 joined." in door.stdout.read()
        assert door.wait(WAIT_S) == 0
    if "cam2" in site.programs:
        site.send("cam2", signal.SIGKILL)
        site.wait("cam2")
    site.start("cam2", *e3pose("camera", str(tmp_path / "pi" / "cam2.toml")))
    site.becomes("cam0", "cam1", "cam2")


@in_browser
def test_dead_edge_is_told_within_seconds_and_the_notice_goes_when_it_is_back(
    site: LiveSite, url: str, page: Page
) -> None:
    page.open(f"{url}#token={token_of(site)}")
    assert page.shows("state", "live")
    assert page.run("document.getElementById('notice').hidden")
    site.send("edge", signal.SIGKILL)
    site.wait("edge")
    begun_s = time.monotonic()
    assert page.shows("notice", "Edge gone since ") and page.text("state") == "edge gone"
    assert time.monotonic() - begun_s < GONE_S
    assert page.run("getComputedStyle(document.getElementById('scene')).opacity < 0.6")
    assert eventually(lambda: "edge gone" in page.text("tiles") and " ago" in page.text("tiles"))
    with client_of(site, url) as client:
        assert client.get("api/status").json()["silent_s"] > 2
    page.open(f"{url}#token={token_of(site)}")  # a browser that comes later is told as well
    assert page.shows("notice", "Edge gone since ")
    site.start_edge()
    assert eventually(lambda: page.run("document.getElementById('notice').hidden"), 240)
    assert page.shows("state", "live")
    assert not page.run("document.body.classList.contains('stale')")
    assert page.messages == []
