"""Crowds, slow requests, odd bodies and guesses keep nobody else out, with real sockets."""

from __future__ import annotations

import json
import socket
import time
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest
from tests.cases import each_case
from tests.site.web.watched import Watched, watched_site
from tests.waiting import eventually
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect as connect_socket

import e3pose.site.web.access as limits
from e3pose.base.listener import Bounds
from e3pose.site.serving import Serving
from e3pose.site.web.access import FREE, Guesses
from e3pose.site.web.feed import MAX_OF_ADDRESS

JSON = {"Content-Type": "application/json"}
HALF = b"GET /api/status HTTP/1.1\r\nHost: localhost\r\n"


def connected(watched: Watched) -> socket.socket:
    return socket.create_connection(("127.0.0.1", watched.view.address.port), timeout=20)


def test_three_hundred_idle_connections_keep_nobody_out(watched: Watched) -> None:
    watched.publish(3)
    with ExitStack() as stack:
        for _ in range(150):
            stack.enter_context(connected(watched))
            stack.enter_context(connected(watched)).sendall(HALF)
        for _ in range(100):  # answered once
            one = stack.enter_context(connected(watched))
            one.sendall(HALF.replace(b"/api/status", b"/favicon.ico") + b"\r\n")
            assert one.recv(100).startswith(b"HTTP/1.1")  # 204, or 429 after so many
        for path in ("/", "/api/status", "/api/site"):
            with watched.client(watched.view.tokens.read) as client:
                assert client.get(path).status_code == 200, path


@each_case(
    "said",
    [b"", HALF, b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\nhalf"],
    ids=["nothing", "half a head", "half a body"],
)
def test_request_that_is_not_completed_ends(said: bytes) -> None:
    async def app(scope: object, receive: object, send: object) -> None:
        while True:
            message = await receive()  # type: ignore[operator]
            if not message.get("more_body"):
                return

    listening = socket.create_server(("127.0.0.1", 0))
    serving = Serving(app, listening, Bounds(8, 8, request_s=0.5), None)
    try:
        with socket.create_connection(listening.getsockname(), timeout=20) as slow:
            slow.sendall(said)
            begun_s = time.monotonic()
            try:
                while slow.recv(1000):
                    pass
            except ConnectionError:
                pass
            assert time.monotonic() - begun_s < 15
    finally:
        serving.close()


@each_case(
    "body",
    [
        '{"cameras": NaN}',
        '{"cameras": Infinity}',
        '{"cameras": -Infinity}',
        '{"cameras": 1e999}',
        '{"cameras": ' + "9" * 4000 + "}",
        '{"cameras": ' + "[" * 1900 + "]" * 1900 + "}",
        "[" * 4000,
        "[" * 400 + "]" * 400,
        '{"cameras": "\\ud800"}',
        '{"\\ud800": 1}',
        '{"cameras": 1, "x": NaN}',
        "NaN",
        "",
        "\x00",
        '{"target_error_mm": 1e308}',
        '{"quality_weight": NaN}',
        b"\xff\xfe\x00{",
        b'{"cameras": "\xff"}',
    ],
    ids=lambda body: body[:20],
)
def test_odd_body_is_refused_with_a_reason(watched: Watched, body: str | bytes) -> None:
    with watched.client(watched.view.tokens.write) as client:
        coded = body if isinstance(body, bytes) else body.encode(errors="surrogatepass")
        answer = client.post("/api/control/loop", content=coded, headers=JSON)
    assert 400 <= answer.status_code < 500, answer.text
    assert 5 < len(answer.json()["detail"]) < 1000
    if body == '{"cameras": NaN}':
        assert answer.json()["detail"] == "cameras: Input should be a finite number"


def test_guessing_is_slow_and_the_owner_comes_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first_s, longest_s, guesses = 0.01, 0.4, int(FREE) + 6
    monkeypatch.setattr(limits, "FIRST_WAIT_S", first_s)  # all waits are so much shorter
    monkeypatch.setattr(limits, "LONGEST_WAIT_S", longest_s)
    waits_s: list[float] = []
    wait_s = Guesses.wait_s

    def noted(self: Guesses, address: str, token: str) -> float:
        waits_s.append(wait_s(self, address, token))
        return waits_s[-1]

    monkeypatch.setattr(Guesses, "wait_s", noted)
    with watched_site(tmp_path) as made, ExitStack() as stack:
        made.view.rules.guesses = Guesses(lambda: 0.0)  # nothing is forgiven meanwhile
        known = stack.enter_context(made.client(made.view.tokens.read))
        assert known.get("/api/site").json()["scope"] == "read"
        guesser = stack.enter_context(made.client("x" * 20))
        begun_s = time.monotonic()
        for _ in range(guesses):
            assert guesser.get("/api/site").status_code == 401
        assert time.monotonic() - begun_s >= sum(waits_s) >= first_s * (2**6 - 1)
        assert known.get("/api/site").status_code == 200
        assert waits_s[-1] == 0.0, "who is in does not notice"
        owner = stack.enter_context(made.client(made.view.tokens.write))
        begun_s = time.monotonic()
        assert owner.get("/api/site").json()["scope"] == "write"
        assert time.monotonic() - begun_s >= waits_s[-1] == longest_s
        assert owner.get("/api/site").status_code == 200 and waits_s[-1] == 0.0


def test_one_address_does_not_take_all_live_feeds(watched: Watched) -> None:
    url = watched.view.url.replace("http", "ws", 1) + "api/live"
    assert eventually(lambda: watched.view.feed.followers == 0)
    watched.publish(3)
    with ExitStack() as stack:
        for _ in range(MAX_OF_ADDRESS):
            assert json.loads(stack.enter_context(connect_socket(url)).recv(20))
        with connect_socket(url) as one_more, pytest.raises(ConnectionClosed, match="1013"):
            one_more.recv(20)
        with watched.client() as client:
            assert client.get("/api/live").status_code == 503
        assert not watched.view.feed.full("10.0.0.1")
    assert eventually(lambda: watched.view.feed.followers == 0)


def test_client_behind_a_named_proxy_needs_a_token_for_reading(
    watched: Watched,
) -> None:
    rules = watched.view.rules
    before = (rules.proxies, rules.open_reading)
    rules.proxies, rules.open_reading = frozenset({"127.0.0.1"}), False
    try:
        with httpx.Client(base_url=watched.view.url) as client:
            headers = {"X-Forwarded-For": "10.0.0.9", "X-Forwarded-Proto": "https"}
            assert client.get("/api/site", headers=headers).status_code == 401
            headers["Authorization"] = f"Bearer {watched.view.tokens.read}"
            headers["Origin"] = str(client.base_url).rstrip("/").replace("http:", "https:")
            assert client.get("/api/site", headers=headers).status_code == 200
    finally:
        rules.proxies, rules.open_reading = before
