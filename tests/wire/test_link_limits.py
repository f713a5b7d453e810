"""What a link takes in from anybody: little memory, few sessions, a short silence."""

from __future__ import annotations

import json
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from socket import create_connection
from typing import Any

import psutil
import pytest
import zenoh
from tests.waiting import eventually
from tests.wire.certified_site import Site

from e3pose.wire import access
from e3pose.wire.access import Link, zenoh_config
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import certificates_in

pytestmark = pytest.mark.slow

LARGE = 60_000_000
PRIORITIES = [
    getattr(zenoh.Priority, name)
    for name in (
        "REAL_TIME",
        "INTERACTIVE_HIGH",
        "INTERACTIVE_LOW",
        "DATA_HIGH",
        "DATA",
        "DATA_LOW",
        "BACKGROUND",
    )
]
GROWTH = 50_000_000  # bytes: less than one of the messages that are sent
EDGE = """
import sys
from pathlib import Path
from e3pose.wire.keys.folder import certificates_in, read_roll
from e3pose.wire.access import Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.network import open_network
keys, endpoint = Path(sys.argv[1]), read_endpoint(sys.argv[2])
roll = read_roll(keys)
edge = open_network(Link("edge", "lab", endpoint, certificates_in(keys, "edge")), roll)
edge.subscribe("e3pose/lab/camera/*/view", lambda topic, payload: print(len(payload), flush=True))
print("ready", flush=True)
sys.stdin.read()
"""


@contextmanager
def edge_process(site: Site) -> Iterator[subprocess.Popen[str]]:
    """Run an edge's link in a process of its own, whose memory can be looked at."""
    command = [sys.executable, "-c", EDGE, str(site.folder), f"tls/127.0.0.1:{site.port}"]
    edge = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert edge.stdin is not None and edge.stdout is not None
    try:
        assert edge.stdout.readline() == "ready\n"
        yield edge
    finally:
        edge.kill()
        edge.wait()
        edge.stdin.close()
        edge.stdout.close()


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    made = Site(tmp_path / "keys")
    yield made
    for transport in made.open:
        transport.close()


def attacker(site: Site, camera_id: str) -> Any:
    """Join with a camera's certificate and without the limits of our own programs."""
    files = certificates_in(site.folder / "cameras" / camera_id, "camera")
    config = zenoh_config(Link("camera", "lab", read_endpoint(f"tls/localhost:{site.port}"), files))
    config["transport"] = {"link": {"tls": config["transport"]["link"]["tls"]}}
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


def connections(edge: psutil.Process) -> int:
    return sum(c.status == psutil.CONN_ESTABLISHED for c in edge.net_connections("tcp"))


@pytest.mark.parametrize("camera_id", ["cam1", "cam3"])  # of the roll; revoked
def test_large_messages_take_no_memory_of_the_edge(site: Site, camera_id: str) -> None:
    with edge_process(site) as edge:
        watched = psutil.Process(edge.pid)
        before = watched.memory_info().rss
        liars = [attacker(site, camera_id) for _ in range(2)]
        assert eventually(lambda: connections(watched) == len(liars))
        message = zenoh.ZBytes(b"x" * LARGE)

        def flood(liar: Any) -> None:
            for priority in PRIORITIES:
                liar.put(
                    f"e3pose/lab/camera/{camera_id}/view",
                    message,
                    congestion_control=zenoh.CongestionControl.BLOCK,
                    priority=priority,
                )

        floods = [threading.Thread(target=flood, args=(liar,)) for liar in liars]
        for thread in floods:
            thread.start()
        most = before
        while any(thread.is_alive() for thread in floods):
            most = max(most, watched.memory_info().rss)
            time.sleep(0.01)
        end_s = time.monotonic() + 1.0  # of what is still on its way
        while time.monotonic() < end_s:
            most = max(most, watched.memory_info().rss)
            time.sleep(0.01)
        for liar in liars:
            liar.close()
    assert most - before < GROWTH


def test_who_only_shows_a_certificate_is_given_up(site: Site) -> None:
    with edge_process(site) as edge:
        files = certificates_in(site.folder / "cameras" / "cam3", "camera")
        context = ssl.create_default_context(cafile=str(files.authority))
        context.load_cert_chain(str(files.certificate), str(files.key))
        place, begun_s = ("127.0.0.1", site.port), time.monotonic()
        silent = [
            context.wrap_socket(create_connection(place), server_hostname="localhost")
            for _ in range(5)
        ]
        watched = psutil.Process(edge.pid)
        assert connections(watched) == len(silent)
        assert eventually(lambda: connections(watched) == 0)
        assert time.monotonic() - begun_s < access.JOIN_MS / 1e3 + 3.0
        for one in silent:
            with suppress(OSError):
                one.close()


def test_session_beyond_the_limit_waits(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(access, "MAX_SESSIONS", 2)
    edge = site.edge()
    heard: list[str] = []
    edge.subscribe("e3pose/lab/camera/*/view", lambda topic, payload: heard.append(topic))

    def says(camera_id: str) -> bool:
        topic = f"e3pose/lab/camera/{camera_id}/view"
        cameras[camera_id].publish(topic, b"x")
        return topic in heard

    cameras = {"cam1": site.camera("cam1")}
    assert eventually(lambda: says("cam1"))
    revoked = site.camera("cam3")  # takes a place, and says nothing with it
    assert eventually(lambda: len(edge._session.info.links()) == 2)
    cameras["cam2"] = site.camera("cam2")
    assert not eventually(lambda: says("cam2"), 2.0)
    revoked.close()
    assert eventually(lambda: says("cam2"))
    edge.close()
