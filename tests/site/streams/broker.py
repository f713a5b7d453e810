"""As much of an MQTT 3.1.1 broker as a test needs: sessions, subscriptions by prefix, retained."""

from __future__ import annotations

import queue
import socket
import socketserver
import ssl
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

CONNECT, PUBLISH, SUBSCRIBE, PING, END = 1, 3, 8, 12, 14


class Broker(socketserver.ThreadingTCPServer):
    """Passes on what is published on topics that begin as somebody asked for."""

    daemon_threads, allow_reuse_address = True, True

    def __init__(self, login: tuple[str, str] | None, secure: ssl.SSLContext | None) -> None:
        super().__init__(("127.0.0.1", 0), _Session)
        self.login = login
        if secure is not None:
            self.socket = secure.wrap_socket(self.socket, server_side=True)
        self.subscribers: list[tuple[str, socket.socket]] = []
        self.retained: dict[str, bytes] = {}
        self.lock = threading.Lock()

    def publish(self, topic: str, packet: bytes) -> None:
        with self.lock:
            for prefix, subscriber in self.subscribers:
                if topic.startswith(prefix):
                    subscriber.sendall(packet)


class _Session(socketserver.BaseRequestHandler):
    def handle(self) -> None:
        broker = self.server
        assert isinstance(broker, Broker)
        while (head := self._read(1)) is not None:
            length, shift = 0, 0
            while True:
                (byte,) = self._read(1) or b"\0"
                length, shift = length | (byte & 127) << shift, shift + 7
                if byte < 128:
                    break
            body = (self._read(length) or b"") if length else b""
            kind, flags = head[0] >> 4, head[0] & 15
            if kind == CONNECT:
                accepted = broker.login in (None, _login(body))
                self.request.sendall(bytes([0x20, 2, 0, 0 if accepted else 5]))
                if not accepted:
                    return
            elif kind == SUBSCRIBE:
                (size,) = struct.unpack(">H", body[2:4])
                prefix = body[4 : 4 + size].decode().removesuffix("#")
                self.request.sendall(bytes([0x90, 3]) + body[:2] + b"\0")
                with broker.lock:
                    broker.subscribers.append((prefix, self.request))
                    for topic, packet in broker.retained.items():
                        if topic.startswith(prefix):
                            self.request.sendall(packet)
            elif kind == PUBLISH:
                self._publish(broker, flags, body)
            elif kind == PING:
                self.request.sendall(bytes([0xD0, 0]))
            elif kind == END:
                return

    def _publish(self, broker: Broker, flags: int, body: bytes) -> None:
        (size,) = struct.unpack(">H", body[:2])
        topic, rest = body[2 : 2 + size].decode(), body[2 + size :]
        if flags >> 1 & 3:
            self.request.sendall(bytes([0x40, 2]) + rest[:2])
            rest = rest[2:]
        content, length = body[: 2 + size] + rest, b""
        left = len(content)
        while True:
            left, byte = left >> 7, left & 127
            length += bytes([byte | (128 if left else 0)])
            if not left:
                break
        packet = bytes([0x30 | flags & 1]) + length + content
        if flags & 1:
            broker.retained[topic] = packet
        broker.publish(topic, packet)

    def _read(self, count: int) -> bytes | None:
        found = b""
        while len(found) < count:
            part = self.request.recv(count - len(found))
            if not part:
                return None
            found += part
        return found


def _login(body: bytes) -> tuple[str, str] | None:
    """Return user and password of a CONNECT, None where it has none; it leaves no will."""
    if body[7] & 0xC0 != 0xC0:
        return None
    at, words = 10, []
    while at < len(body):
        (size,) = struct.unpack_from(">H", body, at)
        words.append(body[at + 2 : at + 2 + size].decode())
        at += 2 + size
    return words[-2], words[-1]


@contextmanager
def broker(
    login: tuple[str, str] | None = None, secure: ssl.SSLContext | None = None
) -> Iterator[int]:
    """Run a broker; yield its port.

    Args:
        login: user and password, without which nobody comes in; None for everybody.
        secure: its certificate; None for plain text.
    """
    with Broker(login, secure) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        yield int(server.server_address[1])
        server.shutdown()


@contextmanager
def listening(
    port: int, login: tuple[str, str] | None = None, authority: Path | None = None
) -> Iterator[tuple[mqtt.Client, queue.Queue[tuple[str, str]]]]:
    """Connect somebody who hears and may say everything; yield it, and what it hears.

    Args:
        port: of the broker.
        login: see `broker`.
        authority: certificate by which it knows the broker; None for plain text.
    """
    heard: queue.Queue[tuple[str, str]] = queue.Queue()
    ready = threading.Event()
    client = mqtt.Client(CallbackAPIVersion.VERSION2)
    if authority is not None:
        client.tls_set(str(authority))
    if login is not None:
        client.username_pw_set(*login)
    client.on_message = lambda _c, _d, message: heard.put(
        (message.topic, message.payload.decode("utf-8", "replace"))
    )
    client.on_subscribe = lambda *_: ready.set()
    client.connect("localhost" if authority else "127.0.0.1", port)
    client.subscribe("#", qos=1)
    client.loop_start()
    assert ready.wait(20)
    yield client, heard
    client.disconnect()
    client.loop_stop()
