"""Access control of HTTP and WebSocket requests: host, origin, token, rate.

A browser sends what any page of the internet tells it to, also to programs on this machine. So
a request must name a host that is ours (else a foreign name may have been pointed here), come from
our own page or from no page at all, and carry a token beyond loopback and for whatever changes
something.
"""

from __future__ import annotations

import ipaddress
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from starlette.datastructures import Headers
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Send
from starlette.types import Scope as Connection

from e3pose.site.web.rate_limit import Rate
from e3pose.site.web.tokens import Scope, Tokens

PROTOCOL = "e3pose"  # of WebSockets; a token may come as a second one, as browsers send no header
TOKEN_PROTOCOL = "e3pose.token."
# They hold nothing of the site.
OPEN_PATHS = ("/", "/view.js", "/past.js", "/scene.js", "/view.css", "/favicon.ico")
WRITE_PREFIX, PICTURE_PREFIX = "/api/control", "/api/pictures"
READS_PER_S, READ_BURST = 50.0, 100.0
WRITES_PER_S, WRITE_BURST = 5.0, 10.0
GUESSES_PER_S, GUESS_BURST = 0.2, 10.0
MAX_BODY_BYTES = 4096
CLOSED = 4403  # what a WebSocket that was refused would be closed with
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
        "img-src 'self' blob: data:; form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a request is refused.

    Attributes:
        status: of HTTP.
        why: in words, with what to do.
        headers: of the answer.
    """

    status: int
    why: str
    headers: Mapping[str, str] = field(default_factory=dict)


@dataclass(slots=True, eq=False)
class Rules:
    """The access rules.

    Attributes:
        tokens: of the site.
        hosts: names by which this server is reached; addresses need not be named, as no foreign
            page can have the browser believe that an address is its own.
        open_reading: whether reading needs no token: on loopback alone.
        secure: whether it is reached by https.
        reads: how often each client may read.
        writes: how often each may change something.
        guesses: how often each may come with a wrong token.
    """

    tokens: Tokens
    hosts: frozenset[str]
    open_reading: bool
    secure: bool = False
    reads: Rate = field(default_factory=lambda: Rate(READS_PER_S, READ_BURST, time.monotonic))
    writes: Rate = field(default_factory=lambda: Rate(WRITES_PER_S, WRITE_BURST, time.monotonic))
    guesses: Rate = field(default_factory=lambda: Rate(GUESSES_PER_S, GUESS_BURST, time.monotonic))

    def judge(
        self, path: str, headers: Mapping[str, str], client: str
    ) -> tuple[Scope | None, Refusal | None]:
        """Return the scope of a request, and why it is refused; None if it is not.

        Args:
            path: of the request.
            headers: by lower-case name.
            client: address that it comes from.
        """
        host = headers.get("host", "")
        if not self._ours(host):
            return None, Refusal(421, f"host {host[:80]!r} is not this server: see [view] hosts")
        if refusal := self._foreign(path, headers, host):
            return None, refusal
        if refusal := _large(headers):
            return None, refusal
        if path in OPEN_PATHS:
            return None, _late(self.reads.wait_s(client))
        scope: Scope | None = "read" if self.open_reading else None
        if token := token_of(headers):
            found = self.tokens.scope(token)
            if found is None:
                late = _late(self.guesses.wait_s(client))
                return None, late or Refusal(401, "wrong token", BEARER)
            scope = found
        if scope is None:
            return None, Refusal(401, "a token is needed: `e3pose view` prints it", BEARER)
        writes = path.startswith(WRITE_PREFIX)
        if (writes or path.startswith(PICTURE_PREFIX)) and scope != "write":
            why = "the token for writing is needed: `e3pose view` prints it"
            return scope, Refusal(403 if token else 401, why, {} if token else BEARER)
        return scope, _late((self.writes if writes else self.reads).wait_s(client))

    def _ours(self, host: str) -> bool:
        name = host.rpartition(":")[0] if host.rpartition(":")[2].isdigit() else host
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return name.lower() in self.hosts
        return True

    def _foreign(self, path: str, headers: Mapping[str, str], host: str) -> Refusal | None:
        origin = headers.get("origin")
        own = f"{'https' if self.secure else 'http'}://{host}"
        if origin is not None and origin.lower() != own.lower():
            return Refusal(403, f"origin {origin[:80]!r} is not this page")
        # A link that somebody follows to the page is not a request by the page it stands on.
        site = headers.get("sec-fetch-site", "none")
        if site not in ("none", "same-origin") and path not in OPEN_PATHS:
            return Refusal(403, "asked for by another page")
        return None


BEARER = {"WWW-Authenticate": "Bearer"}


def _large(headers: Mapping[str, str]) -> Refusal | None:
    if "transfer-encoding" in headers:
        return Refusal(411, "the length of the body must be stated")
    length = headers.get("content-length", "0")
    if not (length.isascii() and length.isdigit() and int(length[:12]) <= MAX_BODY_BYTES):
        return Refusal(413, f"more than {MAX_BODY_BYTES} bytes")
    return None


def _late(wait_s: float) -> Refusal | None:
    if not wait_s:
        return None
    return Refusal(429, "too many requests", {"Retry-After": str(int(wait_s) + 1)})


def token_of(headers: Mapping[str, str]) -> str:
    """Return the token that a request carries; empty for none."""
    kind, _, value = headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer":
        return value.strip()
    for offered in headers.get("sec-websocket-protocol", "").split(","):
        if offered.strip().startswith(TOKEN_PROTOCOL):
            return offered.strip().removeprefix(TOKEN_PROTOCOL)
    return ""


class Door:
    """Lets in what the rules allow; an ASGI application around another."""

    def __init__(self, app: ASGIApp, rules: Rules) -> None:
        """Stand before an application."""
        self.app, self.rules = app, rules

    async def __call__(self, connection: Connection, receive: Receive, send: Send) -> None:
        """Pass a request on, with its `scope` in the state, or refuse it."""
        if connection["type"] not in ("http", "websocket"):
            return await self.app(connection, receive, send)
        client = str((connection.get("client") or ("", 0))[0])
        headers = Headers(scope=connection)
        scope, refusal = self.rules.judge(connection["path"], headers, client)
        if refusal is None:
            connection.setdefault("state", {})["scope"] = scope
            return await self.app(connection, receive, _with_headers(send))
        if connection["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": CLOSED, "reason": refusal.why})
            return None
        answer = JSONResponse(
            {"detail": refusal.why}, refusal.status, {**HEADERS, **refusal.headers}
        )
        return await answer(connection, receive, send)


def _with_headers(send: Send) -> Send:
    extra: list[tuple[bytes, bytes]] = [
        (name.lower().encode(), value.encode()) for name, value in HEADERS.items()
    ]

    async def forward(message: Message) -> None:
        if message["type"] == "http.response.start":
            given: Any = list(message.get("headers", []))
            named = {name for name, _ in given}
            message["headers"] = given + [pair for pair in extra if pair[0] not in named]
        await send(message)

    return forward
