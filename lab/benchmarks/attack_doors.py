"""Attacks on the doors of a running site: page, metrics, requests of an operator."""

from __future__ import annotations

import contextlib
import http.client
import socket
import time
from collections import Counter
from collections.abc import Callable

from attack_inputs import Result
from e3pose.settings.site_file import load_site
from e3pose.site.follow import viewer_link
from e3pose.site.web.tokens import open_tokens
from e3pose.wire.codec import encode
from e3pose.wire.keys.folder import add_keys
from e3pose.wire.network import open_network
from e3pose.wire.site_messages import Control
from e3pose.wire.topics import of_control
from live_site import Site, wait

OPERATOR = "desk"
HALF = b"GET / HTTP/1.1\r\nHost: localhost\r\nX-Slow: "
Attack = Callable[[float], str]


def doors(site: Site) -> list[tuple[str, float, Attack, str]]:
    """Return attacks by name, with the share of the time that each takes, and what else must be.

    Args:
        site: with a page, and with an operator named `OPERATOR`.
    """
    assert site.page_port is not None
    answered = "; all other requests are answered"
    return [
        ("crowd at the page", 0.1, _crowd(site.page_port, "/api/status"), answered),
        ("crowd at the metrics", 0.1, _crowd(site.metrics_port, "/metrics"), answered),
        ("guessed tokens", 0.1, _guess(site), "; no guess is right, the right token is"),
        ("flood of an operator", 0.15, _flood(site), ""),
    ]


def operator_of(site: Site) -> None:
    """Give the site an operator, whom its edge admits within seconds."""
    import datetime

    now = datetime.datetime.now(datetime.timezone.utc)
    add_keys(site.folder / "keys", OPERATOR, now, kind="operator")
    wait(6.0)


def after(site: Site) -> Result:
    """Return whether anything was lost by the attacks."""
    shed = site.metric("e3pose_store_shed_total")
    return Result("store afterwards", f"{shed:.0f} records shed", shed == 0, "no record lost")


def _answered(port: int, target: str) -> float | None:
    """Return how long an answer takes, seconds; None where there is none."""
    begun_s = time.monotonic()
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5.0)
    try:
        connection.request("GET", target)
        connection.getresponse().read()
        return time.monotonic() - begun_s
    except (OSError, http.client.HTTPException):
        return None
    finally:
        connection.close()


def _crowd(port: int, target: str) -> Attack:
    """Hold 600 connections, half of them with half a request, and ask beside them."""

    def attack(until_s: float) -> str:
        took: list[float | None] = []
        with contextlib.ExitStack() as stack:
            for number in range(600):
                with contextlib.suppress(OSError):
                    one = stack.enter_context(socket.create_connection(("127.0.0.1", port), 5.0))
                    if number % 2:
                        one.sendall(HALF)
            while not took or time.monotonic() < until_s:
                took.append(_answered(port, target))
                wait(0.1)
        slowest = max((one for one in took if one is not None), default=float("nan"))
        lost = took.count(None)
        said = f"600 connections; {len(took)} requests beside them, {lost} lost, {slowest:.2f} s"
        assert not lost, said
        return said

    return attack


def _guess(site: Site) -> Attack:
    """Guess tokens one after the other, then come in with the right one."""

    def attack(until_s: float) -> str:
        port, said = site.page_port, Counter[int]()
        token = open_tokens(site.folder / "view-tokens.toml").write

        def ask(shown: str) -> int:
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20.0)
            with contextlib.closing(connection):
                connection.request("GET", "/api/site", headers={"Authorization": f"Bearer {shown}"})
                return connection.getresponse().status

        begun_s = time.monotonic()
        while time.monotonic() < until_s:
            said[ask(f"guess-{sum(said.values()):020d}")] += 1
        rate = sum(said.values()) / (time.monotonic() - begun_s)
        begun_s = time.monotonic()
        status = ask(token)
        waited_s = time.monotonic() - begun_s
        words = f"{rate:.1f} guesses per second; the right one gets {status} after {waited_s:.1f} s"
        assert status == 200 and not said[200], words
        return words

    return attack


def _flood(site: Site) -> Attack:
    """Send an operator's requests as fast as they are answered."""

    def attack(until_s: float) -> str:
        table = load_site(site.folder / "site.toml")
        folder = site.folder / "keys" / "operators" / OPERATOR
        transport = open_network(viewer_link(table, folder))
        topic, asked = of_control("bench", OPERATOR), 0
        while not transport.connected():
            wait(0.02)
        while time.monotonic() < until_s:
            transport.ask(topic, encode(Control(quality_weight=1.0 + asked % 2)), 2.0)
            asked += 1
        transport.close()
        return f"{asked} requests"

    return attack
