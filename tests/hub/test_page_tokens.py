"""Users of a hub at the live page of a site: by a token each, which goes with their right."""

from __future__ import annotations

import asyncio
import os
import time
from pathlib import Path
from typing import Any

import pytest
from tests.cli.commands import run as verb
from tests.site.tables import write_site

from e3pose.settings.site_file import SiteTable
from e3pose.site.outbox_answers import OutboxAnswers
from e3pose.site.web import access
from e3pose.site.web.access import Door, Rules
from e3pose.site.web.tokens import HEARD_S, PageTokens, hub_tokens, make_tokens
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import OutboxQuestion
from e3pose_hub.settings import Hub, load_hub
from e3pose_hub.users import Users, grant, revoke, users_of

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
def hub(tmp_path: Path) -> Hub:
    (tmp_path / "hub.toml").write_text(HUB)
    return load_hub(tmp_path)


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
