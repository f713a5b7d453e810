"""Users of a hub and its page: rights, tokens, certificates."""

from __future__ import annotations

import asyncio
import datetime
import os
import ssl
import stat
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.cli.commands import run as run_verb
from tests.cli.commands import run as verb
from tests.site.tables import write_site

from e3pose.base.errors import InputError
from e3pose.settings.site_file import SiteTable
from e3pose.site.outbox_answers import OutboxAnswers
from e3pose.site.web import access
from e3pose.site.web.access import Door, Rules
from e3pose.site.web.server import PageServer
from e3pose.site.web.tokens import HEARD_S, PageTokens, hub_tokens, make_tokens
from e3pose.wire.codec import encode
from e3pose.wire.keys.authority import make_authority, make_certificate
from e3pose.wire.site_messages import OutboxQuestion
from e3pose_hub.page import open_page
from e3pose_hub.settings import Hub, load_hub
from e3pose_hub.users import Users, grant, read_users, revoke, users_of

pytestmark = pytest.mark.slow

HUB = """
format = "e3pose-hub"
version = 1
[[site]]
name = "lab"
endpoint = "tcp/127.0.0.1:7000"
group = "clinics"
page = "https://127.0.0.1:8000/"
page_users = true
[[site]]
name = "gym"
endpoint = "tcp/127.0.0.1:7001"
group = "sports"
"""


@pytest.fixture
def house(tmp_path: Path) -> Path:
    (tmp_path / "hub.toml").write_text(HUB)
    return tmp_path


@pytest.fixture
def hub(house: Path) -> Hub:
    return load_hub(house)


def site_of(folder: Path, hubs: str) -> SiteTable:
    folder.mkdir()
    return write_site(folder, f"[view]\nhubs = {hubs}")


def hears(site: SiteTable, hub: Hub, who: str = "house") -> PageTokens:
    """Let a site hear of a hub's users; return how its page judges tokens then."""
    answers = OutboxAnswers(site.folder / "none.db", "lab", tokens=hub_tokens(site))
    group = hub.sites["lab"].group
    asked = OutboxQuestion(0, *users_of(hub).page_tokens("lab", group))
    answers.answer(f"e3pose/lab/outbox/{who}", encode(asked))
    return PageTokens(make_tokens(), tuple(hub_tokens(site).values()))


def token(hub: Hub, user: str, site: str = "lab") -> str:
    (found,) = (each for each in Users(users_of(hub).path).all() if each.name == user)
    return found.page_token(site)


def test_a_token_goes_with_the_right(hub: Hub, tmp_path: Path) -> None:
    site = site_of(tmp_path / "lab", '["house"]')
    grant(hub, "ada", "operator", ("clinics",))
    grant(hub, "bob", "viewer", ("clinics",))
    grant(hub, "eve", "operator", ("sports",))
    ada, bob, eve = (token(hub, name) for name in ("ada", "bob", "eve"))
    assert len({ada, bob, eve, token(hub, "ada", "gym")}) == 4
    page = hears(site, hub)
    assert (page.scope(ada), page.scope(bob), page.scope(eve)) == ("write", "read", None)
    assert page.scope(page.own.write) == "write" and page.scope("") is None
    written = next((tmp_path / "lab" / "hub-tokens").iterdir())
    assert ada not in written.read_text() and written.stat().st_mode & 0o777 == 0o600
    revoke(hub, "ada")
    grant(hub, "bob", "viewer", ("clinics",))  # again: the token of before is another
    page = hears(site, hub)
    assert (page.scope(ada), page.scope(bob), page.scope(token(hub, "bob"))) == (None, None, "read")
    # A hub of which nothing is heard can revoke nothing: its users are out after an hour.
    old_s = time.time() - HEARD_S - 60
    os.utime(written, (old_s, old_s))
    assert page.scope(token(hub, "bob")) is None


def test_only_hubs_that_the_site_names_let_somebody_in(hub: Hub, tmp_path: Path) -> None:
    grant(hub, "ada", "operator", ("clinics",))
    nobody = site_of(tmp_path / "nobody", "[]")
    assert hears(nobody, hub).scope(token(hub, "ada")) is None
    other = site_of(tmp_path / "other", '["house"]')
    assert hears(other, hub, who="stranger").scope(token(hub, "ada")) is None
    assert not (tmp_path / "other" / "hub-tokens").exists()


def test_revoke_says_when_sites_hear_of_it(hub: Hub, capsys: pytest.CaptureFixture[str]) -> None:
    grant(hub, "ada", "viewer", ("clinics",))
    assert verb("hub", "revoke", hub.path, "ada") == 0
    assert "at sites with the next question, in about 60 s" in capsys.readouterr().out


class Judge:
    """Lets one token in, until it does not."""

    there = True

    def scope(self, token: str) -> Any:
        return "read" if self.there else None


@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_what_is_open_ends_when_its_token_is_revoked(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(access, "LOOK_S", -1.0)
    judge, sent = Judge(), list[dict[str, Any]]()
    part: dict[str, Any] = {"type": "websocket.send", "text": "a slot"}
    if kind == "http":
        part = {"type": "http.response.body", "body": b"a slot", "more_body": True}

    async def app(connection: Any, receive: Any, send: Any) -> None:
        for number in range(5):
            judge.there = number < 2
            await send(part)

    async def put(message: Any) -> None:
        sent.append(message)

    async def receive() -> dict[str, Any]:
        return {"type": f"{kind}.disconnect"}

    headers = [(b"host", b"localhost"), (b"authorization", b"Bearer secret-secret-secret")]
    connection = {"type": kind, "path": "/api/live", "headers": headers, "client": ("::1", 1)}
    door = Door(app, Rules(judge, frozenset({"localhost"}), False))
    if kind == "websocket":
        with pytest.raises(RuntimeError, match="revoked"):
            asyncio.run(door(connection, receive, put))
        assert [message["type"] for message in sent] == ["websocket.send"] * 2 + ["websocket.close"]
    else:
        asyncio.run(door(connection, receive, put))
        assert [message.get("more_body", False) for message in sent] == [True, True, False]


def write_pair(folder: Path, make: Callable[[], tuple[bytes, bytes]], key: bool = True) -> str:
    """Put a new certificate into the folder; return it as a client gets it."""
    certificate, secret = make()
    (folder / "hub.pem").write_bytes(certificate)
    if key:
        (folder / "hub.key").write_bytes(secret)
    return ssl.DER_cert_to_PEM_cert(ssl.PEM_cert_to_DER_cert(certificate.decode()))


def shown(page: PageServer) -> str:
    return ssl.get_server_certificate(("127.0.0.1", int(page.url.rpartition(":")[2].strip("/"))))


def test_certificate_that_is_not_there_is_told_with_the_file(tmp_path: Path) -> None:
    (tmp_path / "hub.toml").write_text(
        'format = "e3pose-hub"\nversion = 1\n[view]\ncertificate = "hub.pem"\nkey = "hub.key"\n'
    )
    with pytest.raises(
        InputError, match=r"hub\.toml: view\.certificate, view\.key: found hub\.pem"
    ):
        open_page(load_hub(tmp_path))
    with pytest.raises(InputError, match=r"view\.listen: found 'x', expected HOST:PORT"):
        open_page(load_hub(tmp_path), "x")


def test_renewed_certificate_is_shown_and_a_wrong_pair_is_told_and_not(tmp_path: Path) -> None:
    now = datetime.datetime.now(datetime.timezone.utc)
    authority = make_authority("house", now)

    def make() -> tuple[bytes, bytes]:
        return make_certificate(*authority, "hub", ["localhost", "127.0.0.1"], now)

    first, told = write_pair(tmp_path, make), list[str]()
    (tmp_path / "hub.toml").write_text(
        'format = "e3pose-hub"\nversion = 1\n'
        '[view]\nlisten = "127.0.0.1:0"\ncertificate = "hub.pem"\nkey = "hub.key"\n'
    )
    with open_page(load_hub(tmp_path), report=told.append) as page:
        assert page.running() and shown(page) == first and not told
        write_pair(tmp_path, make, key=False)  # half of a renewal
        assert page.running() and page.running()
        assert shown(page) == first
        assert len(told) == 1 and "the one before is" in told[0]
        second = write_pair(tmp_path, make)
        assert page.running() and shown(page) == second != first
        assert told[1:] == ["certificate of the page renewed"]
        (tmp_path / "hub.key").unlink()  # between two steps of whoever replaces it
        assert page.running() and shown(page) == second


def test_a_token_has_the_rights_that_were_granted_until_they_are_revoked(house: Path) -> None:
    hub = load_hub(house)
    users = users_of(hub)
    ada, bob = grant(hub, "ada", "operator", ("clinics",)), grant(hub, "bob", "viewer", ("sports",))
    assert (users.scope(ada), users.scope(bob)) == ("write", "read")
    found = users.of_token(bob)
    assert found is not None and hub.of_groups(found.groups) == ["gym"]
    again = grant(hub, "bob", "viewer", ("clinics", "sports"))
    assert users.of_token(bob) is None and users.scope(again) == "read"
    revoke(hub, "ada")
    assert users.scope(ada) is None and [user.name for user in read_users(users.path)] == ["bob"]
    assert users.scope("") is None and users.scope("\ud800") is None


def test_file_is_private_and_has_no_token(house: Path) -> None:
    token = grant(load_hub(house), "ada", "viewer", ("clinics",))
    path = house / "users.toml"
    assert token not in path.read_text() and stat.S_IMODE(path.stat().st_mode) == 0o600


def test_commands_grant_list_and_revoke(house: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_verb("hub", "grant", house, "ada", "--operator", "--group", "clinics") == 0
    assert "ada: token " in capsys.readouterr().out
    assert run_verb("hub", "grant", house, "bob", "--viewer", "--group", "clinics") == 0
    capsys.readouterr()
    assert run_verb("hub", "users", house) == 0
    assert capsys.readouterr().out.split() == [
        "name", "role", "groups", "sites", "ada", "operator", "clinics", "1", "bob", "viewer",
        "clinics", "1",
    ]  # fmt: skip
    assert run_verb("hub", "revoke", house, "bob") == 0
    assert run_verb("hub", "revoke", house, "bob") == 2
    assert "NAME: found 'bob', expected one of ada" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("ada", "--group", "clinics"), "--viewer, --operator: expected one of them"),
        (("ada", "--viewer"), "--group: not found"),
        (("ada", "--viewer", "--group", "x"), "--group: found 'x', expected one of clinics"),
        (("../ada", "--viewer", "--group", "clinics"), "NAME: found '../ada'"),
    ],
)
def test_wrong_grants_are_told(
    house: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: str
) -> None:
    assert run_verb("hub", "grant", house, *words) == 2
    assert said in capsys.readouterr().err
    assert not (house / "users.toml").exists()


@pytest.mark.parametrize("text", ["x = 1", 'format = "x"', "user = 1", "[[user]]\nname = 'a'"])
def test_wrong_file_of_users_lets_nobody_in(house: Path, text: str) -> None:
    (house / "users.toml").write_text(text)
    with pytest.raises(InputError, match=r"users\.toml"):
        users_of(load_hub(house)).scope("token")
