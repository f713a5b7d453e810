"""Streams' bytes on the wire against what docs/how-to/streams.md promises of each target."""

from __future__ import annotations

import datetime
import json
import re
import socket
import ssl
import struct
import threading
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import numpy as np
import psutil
import pytest
from tests.cases import each_case
from tests.ports import free_port
from tests.site.streams.broker import broker
from tests.site.streams.test_streams import EVENT, FELL, SOURCE, WATCH, slot
from tests.waiting import eventually
from websockets.sync.client import connect as connect_socket
from websockets.typing import Subprotocol

from e3pose.site.streams import OVER_TLS, open_stream
from e3pose.site.streams.base import Stream, TellsPeople
from e3pose.wire.keys.folder import init_keys

ALL_KINDS = 3  # of packets, as the system calls it
PLACE_M = 7.391625  # of somebody, exact in single precision
PLACES = (b"7.3916", struct.pack(">f", PLACE_M), struct.pack("<f", PLACE_M))
SITE, NAME, PASSWORD = "wirelab", "PlantedAda", "planted-horse-battery-staple"
TOLD = replace(
    SOURCE, site=SITE, kinds=("fall",), zones=("door",), cameras=("c0",), names=lambda track: NAME
)
MARKS = (SITE.encode(), NAME.encode(), PASSWORD.encode(), b"fall", *PLACES)


@dataclass
class Capture:
    """What went over loopback, in both directions, by port of either end.

    Attributes:
        taken: by port, its bytes.
        ends: by port, those at the other end.
    """

    taken: dict[int, bytearray] = field(default_factory=dict)
    ends: dict[int, set[int]] = field(default_factory=dict)

    def take(self, packet: bytes) -> None:
        six = packet[12:14] == b"\x86\xdd"
        head = 54 if six else 14 + 4 * (packet[14] & 15)  # Ethernet, then IP
        kind = packet[20] if six else packet[23]
        known = six or packet[12:14] == b"\x08\x00"
        if not known or kind not in (socket.IPPROTO_TCP, socket.IPPROTO_UDP):
            return
        begin = head + (8 if kind == socket.IPPROTO_UDP else 4 * (packet[head + 12] >> 4))
        ports = struct.unpack_from(">HH", packet, head)
        for port, other in (ports, ports[::-1]):
            self.taken.setdefault(port, bytearray()).extend(packet[begin:])
            self.ends.setdefault(port, set()).add(other)

    def beside(self, marks: Iterable[bytes], *own: int) -> set[int]:
        """Return the ports that got one of some marks, and neither are `own` nor talk to them."""
        marks = list(marks)
        taken = list(self.taken.items())
        got = {port for port, sent in taken if any(mark in sent for mark in marks)}
        return {port for port in got if not {port, *self.ends[port]} & {*own}}

    def carries(self, stream: Stream, *marks: bytes) -> bool:
        """Send a slot and more; return whether all marks were seen so far."""
        send(stream)
        return all(any(mark in sent for sent in list(self.taken.values())) for mark in marks)


@contextmanager
def capture() -> Iterator[Capture]:
    """Capture loopback; needs root, and Linux."""
    family = getattr(socket, "AF_PACKET", None)
    try:
        if family is None:
            raise OSError("no packets to capture here")
        raw = socket.socket(family, socket.SOCK_RAW, socket.htons(ALL_KINDS))
    except OSError as error:
        pytest.skip(f"capturing loopback needs root: {error}")
    raw.bind(("lo", 0))
    found = Capture()

    def read() -> None:
        with suppress(OSError):
            while packet := raw.recv(70_000):
                found.take(packet)

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    try:
        yield found
    finally:
        raw.close()


class Answers(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        self.rfile.read(int(self.headers["Content-Length"]))
        self.send_response(200)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None: ...


@contextmanager
def web_server(secure: ssl.SSLContext | None) -> Iterator[int]:
    with HTTPServer(("127.0.0.1", 0), Answers) as server:
        if secure is not None:
            server.socket = secure.wrap_socket(server.socket, server_side=True)
        threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
        yield server.server_address[1]
        server.shutdown()


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wire") / "keys"
    init_keys(folder, "lab", [], datetime.datetime.now(datetime.timezone.utc))
    return folder


@each_case(
    ("kind", "poses", "names"),
    [
        ("osc", True, True),
        ("vmc", True, False),
        ("vrchat", True, False),
        ("mqtt", True, True),
        ("mqtts", False, False),
        ("homeassistant", False, True),
        ("homeassistants", False, False),
        ("webhook:http", False, True),
        ("webhook:https", False, False),
    ],
)
def test_a_target_gets_what_its_row_says_and_no_other_port_anything(
    kind: str, poses: bool, names: bool, keys: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """A name that may be told is in the sentence of an event, where that is sent in clear."""
    secret = tmp_path / "secret"
    secret.write_text(PASSWORD)
    secret.chmod(0o600)
    environment = {
        "E3POSE_WEBHOOK_SECRET_FILE": str(secret), "E3POSE_MQTT_USER": "wall",
        "E3POSE_MQTT_PASSWORD": PASSWORD, "SSL_CERT_FILE": str(keys / "authority.pem"),
    }  # fmt: skip
    for variable, value in environment.items():
        monkeypatch.setenv(variable, value)
    encrypted = kind in OVER_TLS or kind.endswith("https")
    secure = None
    if encrypted:
        secure = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        secure.load_cert_chain(keys / "edge.pem", keys / "edge.key")
    with ExitStack() as stack:
        if kind.startswith("webhook"):
            port = stack.enter_context(web_server(secure))
        elif "mqtt" in kind or "home" in kind:
            port = stack.enter_context(broker(("wall", PASSWORD), secure))
        else:
            port = free_port()
        wire = stack.enter_context(capture())
        stream = open_stream(f"{kind}://localhost:{port}", TOLD)
        for _ in range(3):
            send(stream)
        wanted = b"fall" if names else PLACES[0] if poses else b""
        sent = wire.taken.setdefault(port, bytearray())
        if wanted and not (poses and not names):
            assert eventually(lambda: wanted in sent), bytes(sent[:500])
        assert eventually(lambda: len(sent) > 200)
        stream.close()
        content = bytes(sent)
    clear = [mark for mark in MARKS if mark in content]
    if encrypted:
        assert not clear and content[0] == 22, "a TLS handshake, and nothing that can be read"
    assert (NAME.encode() in content) == names
    moved = any(place in content for place in PLACES) or kind in ("vmc", "vrchat")
    assert moved == poses, "poses go where the page says, and nowhere else"
    assert (PASSWORD.encode() in content) == (kind in ("mqtt", "homeassistant")), "to this machine"
    assert not wire.beside(MARKS[:3], port)


def send(stream: Stream) -> None:
    seen = slot(7)
    seen.people.joints_m[..., 0] = PLACE_M
    stream.slot(seen)
    stream.zone(EVENT)
    if isinstance(stream, TellsPeople):
        stream.people(WATCH, [FELL])


def listens_at(port: int) -> set[str]:
    """Return the addresses at which this program listens to a port."""
    opened = psutil.Process().net_connections("tcp")
    return {c.laddr.ip for c in opened if c.status == "LISTEN" and c.laddr.port == port}


def test_foxglove_tells_its_subscribers_alone() -> None:
    port = free_port()
    with capture() as wire, closing(open_stream(f"foxglove://127.0.0.1:{port}", TOLD)) as stream:
        url, kind = f"ws://127.0.0.1:{port}", [Subprotocol("foxglove.sdk.v1")]
        with connect_socket(url, subprotocols=kind, compression=None) as client:
            client.recv(20)
            channels = json.loads(client.recv(20))["channels"]
            assert [one["topic"] for one in channels] == [
                "/scene",
                "/poses",
                "/zones",
                "/events",
            ]
            send(stream)
            client.send("garbage")
            client.recv(20)  # the answer: what came before is on the wire
            before = bytes(wire.taken[port])
            assert NAME.encode() not in before and PLACES[0] not in before
            wanted = [{"id": one["id"], "channelId": one["id"]} for one in channels]
            client.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
            assert eventually(lambda: wire.carries(stream, NAME.encode(), PLACES[0]))
        assert listens_at(port) == {"127.0.0.1"}, "the host that is named"
    assert not wire.beside((SITE.encode(), NAME.encode(), *PLACES), port)


def test_lsl_tells_its_readers_poses_and_no_name() -> None:
    import pylsl

    name, place = f"e3pose-wire-{free_port()}", struct.pack("<d", float(np.float32(PLACE_M)))
    with capture() as wire, closing(open_stream(f"lsl:{name}", TOLD)) as stream:
        send(stream)
        inlets, ports = [], list[int]()
        for one in (name, f"{name}-zones", f"{name}-events"):
            (info,) = pylsl.resolve_byprop("name", one, timeout=20)
            ports += map(int, re.findall(r"<v[46]data_port>([0-9]+)<", info.as_xml()))
            inlets.append(pylsl.StreamInlet(info))
        assert not wire.beside([place]), "nothing is sent before somebody reads"
        for inlet in inlets:
            inlet.open_stream(timeout=20)
        assert eventually(lambda: wire.carries(stream, place, b"fall begun 7"))
        assert all(listens_at(port) <= {"0.0.0.0", "::"} for port in ports), "to all interfaces"
        assert any(listens_at(port) for port in ports)
        for inlet in inlets:
            inlet.close_stream()
    assert not wire.beside((place, b"fall begun", b"enter door"), *ports)
    assert not wire.beside([NAME.encode()])
