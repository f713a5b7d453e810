"""A phone as a source of frames: it opens an https page and sends pictures of its camera.

The phone keeps its page open and tries again each second, so that whoever reads the source next
(the set-up, a recording, the running site) gets its frames: nothing listens while nobody reads.
"""

from __future__ import annotations

import json
import math
import socket
import ssl
import threading
import time
import zlib
from contextlib import suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler
from importlib import resources
from pathlib import Path
from socketserver import TCPServer
from typing import Any

import numpy as np

from e3pose.base.clock import Clock
from e3pose.base.errors import InputError, reason_of
from e3pose.base.jpeg import MAX_PIXELS, jpeg_size
from e3pose.base.system import claim_address
from e3pose.camera.base import LiveFrame
from e3pose.camera.frame_rate import FrameRate
from e3pose.camera.phone_file import CERTIFICATE, KEY, load_phone, save_phone
from e3pose.camera.source import FALLBACK_RATE, decode_picture

# The server of one phone, by https: its page, and the frames that it sends. All is bounded.
#
#     GET  /                    the page; it holds nothing of the site
#     POST /join   CODE         a secret, for the one phone that shows the code
#     GET  /time                the camera's time, from which the phone knows its own offset
#     POST /frame  JPEG         with `Taken`, milliseconds since 1970 by the camera's clock
#
# Frames come one after the other, each in a request of its own: WebSockets to a certificate that
# the person accepted by hand are refused by the browsers of some phones.

MAX_FRAME_BYTES, MAX_CODE_BYTES = 2**20, 256
REQUEST_S = 10.0  # for TLS, and between two parts of a request
LINGER_S, LINGER_BYTES = 1.0, 2**21  # in which a refused body is read and forgotten
CONNECTIONS, PER_ADDRESS = 24, 8
PAGES = {
    "/": ("phone.html", "text/html"),
    "/phone.js": ("phone.js", "text/javascript"),
    "/phone.css": ("phone.css", "text/css"),
}
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
        "form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(self), microphone=()",
    "Cache-Control": "no-store",
}


class PhoneServer(TCPServer):
    """A server at work, until `close`."""

    request_queue_size = 32

    def __init__(self, taker: PhoneSource, listen: str, port: int, folder: Path) -> None:
        """Serve.

        Args:
            taker: takes frames, and knows codes.
            listen: address of this machine.
            port: at it.
            folder: with the certificate.

        Raises:
            InputError: without a certificate.
            OSError: where the port is taken.
        """
        self.taker, self._secure = taker, ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        try:
            self._secure.load_cert_chain(folder / CERTIFICATE, folder / KEY)
        except OSError:  # ssl.SSLError is one
            where = folder / CERTIFICATE
            raise InputError(
                f"{where}: no certificate, expected what `e3pose phone` makes"
            ) from None
        self._held: dict[Any, tuple[socket.socket, bool, float]] = {}  # by address and port:
        # the connection, whether the phone has spoken over it, and when it last did
        self._lock = threading.Lock()
        super().__init__((listen, port), _Requests)
        self._thread = threading.Thread(target=self.serve_forever, args=(0.1,), daemon=True)
        self._thread.start()

    def server_bind(self) -> None:
        """Take the port, also shortly after another program had it."""
        claim_address(self.socket)
        super().server_bind()

    def close(self) -> None:
        """End, with all connections."""
        self.shutdown()
        self.server_close()
        self._thread.join(2)
        with self._lock:
            held = list(self._held.values())
        for one, _, _ in held:
            _cut(one)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection on a thread of its own, if there are not too many."""
        with self._lock:
            same = [at for at in self._held if at[0] == client_address[0]]
            full = same if len(same) >= PER_ADDRESS else []
            full = full or (list(self._held) if len(self._held) >= CONNECTIONS else [])
            if full:  # the phone's connections last, and the one longest silent first
                _cut(self._held.pop(min(full, key=lambda at: self._held[at][1:]))[0])
            self._held[client_address] = request, False, time.monotonic()
        threading.Thread(target=self._serve, args=(request, client_address), daemon=True).start()

    def heard(self, client_address: Any) -> None:
        """Note that a connection is that of the phone."""
        with self._lock:
            if client_address in self._held:
                self._held[client_address] = self._held[client_address][0], True, time.monotonic()

    def _serve(self, request: socket.socket, client_address: Any) -> None:
        secure = None
        try:
            request.settimeout(REQUEST_S)
            own = request.dup()  # `wrap_socket` takes it over; the other one stays ours to cut
            secure = self._secure.wrap_socket(own, server_side=True)
            _Requests(secure, client_address, self)
        except (OSError, ValueError):  # ssl.SSLError and timeouts are OSErrors
            pass
        finally:
            with self._lock:
                self._held.pop(client_address, None)
            for one in (secure, request):
                with suppress(OSError):
                    if one is not None:
                        one.close()


def _cut(request: socket.socket) -> None:
    with suppress(OSError):
        request.shutdown(socket.SHUT_RDWR)


class _Requests(BaseHTTPRequestHandler):
    """Answers the requests of one connection."""

    protocol_version, server_version, sys_version = "HTTP/1.1", "e3pose", ""
    timeout = REQUEST_S
    server: PhoneServer
    _read = False  # whether the body of the request was

    def do_GET(self) -> None:
        if self.path in PAGES:
            name, kind = PAGES[self.path]
            body = resources.files("e3pose.camera").joinpath(name).read_bytes()
            return self._answer(200, body, f"{kind}; charset=utf-8")
        if self.path == "/time":
            return self._told() if self._allowed() else None
        return self._refuse(404, "nothing is here")

    def do_POST(self) -> None:
        self._read = False
        if self.path == "/join":
            body = self._body(MAX_CODE_BYTES)
            if body is None:
                return None
            try:
                secret = self.server.taker.join(body.decode("ascii", "replace"))
            except InputError as error:
                return self._refuse(403, str(error))
            self.server.heard(self.client_address)
            return self._said({"secret": secret})
        if self.path != "/frame":
            return self._refuse(404, "nothing is here")
        if not self._allowed():
            return None
        body = self._body(MAX_FRAME_BYTES)
        if body is None:
            return None
        try:
            taken_ms = self._number("Taken")
            taken_ns = None if taken_ms is None else round(taken_ms * 1e6)
            fps = self.server.taker.take(body, taken_ns, self._number("Rate"))
        except InputError as error:
            return self._refuse(415, str(error))
        return self._said({"fps": round(fps, 1)})

    def _told(self) -> None:
        self._said({"now_ms": self.server.taker.clock.now_ns() / 1e6})

    def _allowed(self) -> bool:
        """Return whether the phone asks, from our page; refuse it otherwise."""
        origin = self.headers.get("Origin")
        if origin is not None and origin != f"https://{self.headers.get('Host', '')}":
            self._refuse(403, "asked for by another page")
            return False
        kind, _, secret = self.headers.get("Authorization", "").partition(" ")
        if kind != "Bearer" or not self.server.taker.sends(secret[:128]):
            self._refuse(401, "This phone is not the one of this camera")
            return False
        self.server.heard(self.client_address)
        return True

    def _body(self, most: int) -> bytes | None:
        """Return the body of a request; refuse one that is too long, or of no stated length."""
        stated = self.headers.get("Content-Length", "")
        if "Transfer-Encoding" in self.headers or not (stated.isascii() and stated.isdigit()):
            self._refuse(411, "the length must be stated")
            return None
        if len(stated) > 9 or int(stated) > most:
            self._refuse(413, f"more than {most} bytes")
            return None
        body = self.rfile.read(int(stated))
        self._read = len(body) == int(stated)
        return body if self._read else None

    def _number(self, header: str) -> float | None:
        with suppress(ValueError):
            number = float(self.headers.get(header, "")[:32])
            return number if math.isfinite(number) and abs(number) < 1e15 else None
        return None

    def _said(self, body: dict[str, Any]) -> None:
        self._answer(200, json.dumps(body).encode(), "application/json")

    def _refuse(self, status: int, why: str) -> None:
        """Say no; end the connection where a body was not read, once the other side has heard."""
        self.close_connection = self.close_connection or (self.command == "POST" and not self._read)
        self._answer(status, json.dumps({"detail": why}).encode(), "application/json")
        left = LINGER_BYTES if self.close_connection else 0
        self.connection.settimeout(LINGER_S if left else REQUEST_S)
        while left > 0 and (part := self.rfile.read1(LINGER_BYTES)):
            left -= len(part)

    def _answer(self, status: int, body: bytes, kind: str) -> None:
        self.send_response(status)
        for name, value in {**HEADERS, "Content-Type": kind}.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *arguments: Any) -> None:
        """Say nothing."""


READ_S = 1.0
BIND_S = 3.0  # for the program that read it before to let go of its port
OLDEST_S = 2.0  # of a frame on its way: an earlier time is an error of the phone's clock


@dataclass(slots=True, eq=False)
class PhoneSource:
    """The frames of one phone, the newest alone.

    Attributes:
        path: of its file.
        clock: of the camera; frames have the time at which the phone took them, in this clock.
    """

    path: Path
    clock: Clock
    _server: PhoneServer | None = None
    _newest: LiveFrame | None = None
    _size: tuple[int, int] | None = None
    _last_ns: int = 0
    _nominal: float = FALLBACK_RATE
    _rate: FrameRate = field(default_factory=FrameRate)
    _came: threading.Condition = field(default_factory=threading.Condition)

    @property
    def fps(self) -> float:
        """See `LiveSource.fps`."""
        return self._nominal

    @property
    def port(self) -> int:
        """At which the phone's page is."""
        return load_phone(self.path).port

    def open(self) -> None:
        """See `LiveSource.open`."""
        phone, end_s = load_phone(self.path), time.monotonic() + BIND_S
        while self._server is None:
            try:
                self._server = PhoneServer(self, phone.listen, phone.port, self.path.parent)
            except OSError as error:
                if time.monotonic() > end_s:
                    why = reason_of(error).lower()
                    raise InputError(
                        f"source {self.path.name}: port {phone.port}: {why}; does another program "
                        "read this phone?"
                    ) from None
                time.sleep(0.1)

    def read(self) -> LiveFrame | None:
        """See `LiveSource.read`."""
        with self._came:
            self._came.wait_for(lambda: self._newest is not None, READ_S)
            newest, self._newest = self._newest, None
            return newest

    def close(self) -> None:
        """See `LiveSource.close`."""
        server, self._server, self._size = self._server, None, None
        if server is not None:
            server.close()

    # What follows is called on the server's threads.

    def join(self, code: str) -> str:
        """Return the secret of a phone that shows the code; raise `InputError` for another one."""
        with self._came:
            phone, secret = load_phone(self.path).taken(code, time.time())
            save_phone(self.path, phone)
            return secret

    def sends(self, secret: str) -> bool:
        """Return whether a secret is that of its phone."""
        return load_phone(self.path).sends(secret)

    def take(self, jpeg: bytes, taken_ns: int | None, nominal: float | None) -> float:
        """Take a frame.

        Args:
            jpeg: of it.
            taken_ns: when the phone took it, by the camera's clock as the phone knows it.
            nominal: frames per second that the phone's camera announces.

        Returns:
            Frames per second that came, measured.

        Raises:
            InputError: for what is no JPEG, or of another size than the first, in words for the
                phone.
        """
        try:
            size = jpeg_size(jpeg)
        except InputError as error:
            raise InputError(f"The {error}") from None
        with self._came:
            if self._size not in (None, size):
                raise InputError("The phone was turned: hold it as it was when it began")
            self._size = size
            now_ns = self.clock.now_ns()
            known = taken_ns is not None and 0 <= now_ns - taken_ns < OLDEST_S * 1e9
            captured_ns = taken_ns if taken_ns is not None and known else now_ns
            captured_ns = self._last_ns = max(captured_ns, self._last_ns + 1)
            if nominal is not None and 1 <= nominal <= 240:
                self._nominal = nominal
            self._rate.add(captured_ns)
            self._newest = LiveFrame(
                captured_ns, size, lambda: _decoded(jpeg, size), lambda: zlib.crc32(jpeg)
            )
            self._came.notify()
            return self._rate.hz(self._nominal)


def _decoded(jpeg: bytes, size: tuple[int, int]) -> Any:
    """Return a JPEG as RGB, `(height, width, 3)`; all black where it cannot be decoded."""
    with suppress(InputError):
        image = decode_picture(jpeg, "phone", turned=False, most=MAX_PIXELS)
        if image.shape[:2] == size[::-1]:
            return image
    return np.zeros((size[1], size[0], 3), np.uint8)
