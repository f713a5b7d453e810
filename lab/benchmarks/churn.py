"""What comes and goes at a site: viewers on its wire, connections to its page, a camera."""

from __future__ import annotations

import contextlib
import http.client
import itertools
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect as connect_socket

from e3pose.settings.site_file import load_site
from e3pose.site.follow import Follower, viewer_link
from e3pose.wire import topics
from e3pose.wire.access import Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import certificates_in
from e3pose.wire.network import open_network
from live_site import Site, wait

ENTRY_S = 10.0
PAUSE_S = 0.2  # of each of those at the page, between two visits


@contextlib.contextmanager
def churn(site: Site, viewers: int, visitors: int, camera_id: str) -> Iterator[Counter[str]]:
    """Let viewers, visitors of the page and a camera come and go meanwhile, and count them.

    Args:
        site: with a page.
        viewers: how many come and go at the same time.
        visitors: likewise, of the page.
        camera_id: a camera of the site without a program.
    """
    stopping, seen = threading.Event(), Counter[str]()
    path = site.folder / "site.toml"
    port = site.page_port
    assert port is not None
    kinds: list[tuple[str, Callable[[], object]]] = [
        *[("viewers", lambda: _view(path))] * viewers,
        *zip(
            itertools.repeat("visitors", visitors),
            itertools.cycle([lambda: _ask(port), lambda: _follow(port), lambda: _leave(port)]),
            strict=False,
        ),
        ("cameras", lambda: _appear(path, camera_id)),
    ]

    def repeat(kind: str, visit: Callable[[], object]) -> None:
        while not stopping.is_set():
            with contextlib.suppress(OSError, http.client.HTTPException, WebSocketException):
                visit()
            seen[kind] += 1
            if kind == "visitors":
                stopping.wait(PAUSE_S)

    threads = [threading.Thread(target=repeat, args=one, daemon=True) for one in kinds]
    for thread in threads:
        thread.start()
    try:
        yield seen
    finally:
        stopping.set()
        for thread in threads:
            thread.join(ENTRY_S)


def _view(path: Path) -> None:
    """Join as a viewer, wait for a message, leave."""
    transport, follower = open_network(viewer_link(load_site(path), None)), Follower("bench")
    follower.listen(transport)
    follower.fresh.wait(ENTRY_S)
    transport.close()


def _ask(port: int) -> None:
    """Load the page and the status over one connection."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=ENTRY_S)
    for target in ("/", "/main.js", "/api/site", "/api/status", "/api/poses?start=-2s"):
        connection.request("GET", target)
        connection.getresponse().read()
    connection.close()


def _follow(port: int) -> None:
    """Follow some slots."""
    with connect_socket(f"ws://127.0.0.1:{port}/api/live", open_timeout=ENTRY_S) as following:
        for _ in range(5):
            following.recv(ENTRY_S)


def _leave(port: int) -> None:
    """Follow by server-sent events and go without a word."""
    with socket.create_connection(("127.0.0.1", port), timeout=ENTRY_S) as connection:
        connection.sendall(b"GET /api/live HTTP/1.1\r\nHost: localhost\r\n\r\n")
        connection.recv(1000)


def _appear(path: Path, camera_id: str) -> None:
    """Join with a camera's certificate, be present for a moment, leave."""
    site = load_site(path)
    files = certificates_in(site.keys / "cameras" / camera_id, "camera")
    port = site.link.endpoint.port
    transport = open_network(
        Link("camera", site.name, read_endpoint(f"tls/localhost:{port}"), files)
    )
    heard = threading.Event()
    transport.subscribe(topics.of_order(site.name, camera_id), lambda *_: heard.set())
    transport.be_present(topics.of_camera(site.name, camera_id, "alive"))
    end_s = time.monotonic() + ENTRY_S
    while not transport.connected() and time.monotonic() < end_s:
        wait(0.02)
    heard.wait(2.0)
    transport.close()
