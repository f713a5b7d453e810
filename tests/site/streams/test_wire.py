"""Streams' bytes on the wire against what docs/how-to/streams.md promises of each target."""

from __future__ import annotations

import datetime
import socket
import ssl
import struct
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from tests.cases import each_case
from tests.ports import free_port
from tests.site.streams.broker import broker
from tests.site.streams.test_streams import EVENT, FELL, SOURCE, WATCH, slot
from tests.waiting import eventually

from e3pose.site.streams import OVER_TLS, open_stream
from e3pose.site.streams.base import TellsPeople
from e3pose.wire.keys.folder import init_keys

ALL_KINDS = 3  # of packets, as the system calls it
PLACE_M = 7.391625  # of somebody, exact in single precision
PLACES = (b"7.3916", struct.pack(">f", PLACE_M), struct.pack("<f", PLACE_M))
SITE, NAME, PASSWORD = "wirelab", "PlantedAda", "planted-horse-battery-staple"
MARKS = (SITE.encode(), NAME.encode(), PASSWORD.encode(), b"fall", *PLACES)


@dataclass
class Capture:
    """What went over loopback, in both directions, by port of either end."""

    taken: dict[int, bytearray] = field(default_factory=dict)

    def take(self, packet: bytes) -> None:
        head = 14 + 4 * (packet[14] & 15)  # Ethernet, then IP
        kind = packet[23]
        if packet[12:14] != b"\x08\x00" or kind not in (socket.IPPROTO_TCP, socket.IPPROTO_UDP):
            return
        begin = head + (8 if kind == socket.IPPROTO_UDP else 4 * (packet[head + 12] >> 4))
        for port in struct.unpack_from(">HH", packet, head):
            self.taken.setdefault(port, bytearray()).extend(packet[begin:])


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
        threading.Thread(target=server.serve_forever, daemon=True).start()
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
    told = replace(
        SOURCE, site=SITE, kinds=("fall",), zones=("door",), cameras=("c0",),
        names=lambda track: NAME,
    )  # fmt: skip
    seen = slot(7)
    seen.people.joints_m[..., 0] = PLACE_M
    with ExitStack() as stack:
        if kind.startswith("webhook"):
            port = stack.enter_context(web_server(secure))
        elif "mqtt" in kind or "home" in kind:
            port = stack.enter_context(broker(("wall", PASSWORD), secure))
        else:
            port = free_port()
        wire = stack.enter_context(capture())
        stream = open_stream(f"{kind}://localhost:{port}", told)
        for _ in range(3):
            stream.slot(seen)
            stream.zone(EVENT)
            if isinstance(stream, TellsPeople):
                stream.people(WATCH, [FELL])
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
    for other, leaked in wire.taken.items():
        own = port in (other,) or bytes(leaked) in content or content in bytes(leaked)
        assert own or not any(mark in leaked for mark in MARKS[:3]), other
