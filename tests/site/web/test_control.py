"""Controlling a site over HTTP: with the right token alone, and in the edge's words."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import httpx
import pytest
from tests.cases import each_case
from tests.site.web.watched import Watched

from e3pose.base.errors import InputError
from e3pose.site.web.app import PageContent, make_app
from e3pose.site.web.feed import Feed
from e3pose.wire.codec import decode, encode
from e3pose.wire.site_messages import Control, Controlled


@pytest.fixture
def asked(watched: Watched) -> list[Control]:
    """What reached the edge, which refuses to pause c2."""
    found: list[Control] = []

    def answer(_: str, payload: bytes) -> bytes:
        control = decode(payload, Control, "view")
        found.append(control)
        if control.camera_id == "c2":
            return encode(Controlled(problem="c2 must look"))
        return encode(Controlled(said="done"))

    watched.edge.answers.clear()
    watched.edge.answer("e3pose/lab/control/local", answer)
    return found


@pytest.fixture
def post(watched: Watched) -> Callable[..., tuple[int, str]]:
    def ask(path: str, body: object, token: str = watched.view.tokens.write) -> tuple[int, str]:
        with watched.client(token) as client:
            answer = client.post(f"/api/control/{path}", json=body)
        found = answer.json()
        return answer.status_code, str(found.get("said") or found["detail"])

    return ask


Post = Callable[..., tuple[int, str]]


def test_changes_reach_the_edge_as_asked(post: Post, asked: list[Control]) -> None:
    assert post("loop", {"cameras": 1.5, "quality_weight": 2}) == (200, "done")
    assert post("cameras/c1", {"paused": True}) == (200, "done")
    assert post("cameras/c0", {"budget": "60%"}) == (200, "done")
    assert asked == [
        Control(cameras=1.5, quality_weight=2.0),
        Control(camera_id="c1", paused=True),
        Control(camera_id="c0", budget="60%"),
    ]
    assert post("cameras/c2", {"paused": True}) == (409, "c2 must look"), "the edge refuses it"


@each_case(
    ("path", "body"),
    [
        ("loop", {"cameras": -1}),
        ("loop", {"cameras": "many"}),
        ("loop", {"camera": 1}),
        ("loop", []),
        ("cameras/c1", {"budget": "x" * 100}),
        ("cameras/a%20b", {"paused": True}),
    ],
)
def test_what_makes_no_sense_does_not_reach_the_edge(
    post: Post, asked: list[Control], path: str, body: object
) -> None:
    assert post(path, body)[0] == 422 and asked == []


def test_only_the_write_token_controls(watched: Watched, post: Post, asked: list[Control]) -> None:
    body = {"cameras": 1}
    assert post("loop", body, "")[0] == 401
    assert post("loop", body, "x" * 20)[0] == 401
    assert post("loop", body, watched.view.tokens.read)[0] == 403
    assert post("test-notice", {}, watched.view.tokens.read)[0] == 403
    assert post("test-notice", {})[0] in (404, 405), "a site without events has none"
    assert asked == []


def test_edge_that_is_silent_is_reported(watched: Watched, post: Post) -> None:
    watched.edge.answers.clear()
    status, said = post("loop", {"cameras": 1})
    assert status == 504 and "does not answer" in said


def test_a_test_notice_is_sent_and_its_fate_told() -> None:
    fates: list[list[str] | InputError] = [["webhook a: test notice delivered"], InputError("none")]
    said: list[str] = []

    def test() -> list[str]:
        fate = fates.pop(0)
        if isinstance(fate, InputError):
            raise fate
        return fate

    content = PageContent(Feed("lab"), None, dict, log=said.append, test=test)
    transport = httpx.ASGITransport(app=make_app(content))

    async def send() -> tuple[int, dict[str, str]]:
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as made:
            answer = await made.post("/api/control/test-notice")
        return answer.status_code, answer.json()

    assert asyncio.run(send()) == (200, {"said": "webhook a: test notice delivered"})
    assert asyncio.run(send()) == (409, {"detail": "none"})
    assert said == ["test notice: webhook a: test notice delivered"]
    assert (
        content.body("write")["tests"]
        and not PageContent(Feed("x"), None, dict).body("write")["tests"]
    )
