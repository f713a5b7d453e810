"""Access control of HTTP and WebSocket requests: host, origin, token, rate.

A browser sends what any page of the internet tells it to, also to programs on this machine. So
a request must name a host that is ours (else a foreign name may have been pointed here), come from
our own page or from no page at all, and carry a token beyond loopback and for whatever changes
something.

A token that an address has shown before is accepted at once. Another one waits before it is
compared, right or wrong: the longer, the more wrong tokens came lately from the address, or from
everywhere. So guessing takes years, and an owner who comes in while somebody guesses takes seconds.
"""

from __future__ import annotations

import asyncio
import hmac
import secrets
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

from starlette.datastructures import Headers
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Send
from starlette.types import Scope as Connection

from e3pose.base.listener import is_own_host, network_of
from e3pose.base.rate_limit import Rate
from e3pose.site.web.page import FILES
from e3pose.site.web.tokens import Scope

FREE, FREE_IN_ALL = 10.0, 100.0  # wrong tokens that make nobody wait: of an address, of all
FORGIVEN_PER_S, FORGIVEN_IN_ALL_PER_S = 0.2, 1.0
FIRST_WAIT_S, LONGEST_WAIT_S = 0.25, 4.0
MOST_COUNTED = 10.0  # beyond those that are free: an address is forgiven in a minute
WAITING = 16  # requests of an address that wait; more are refused
MAX_KNOWN = 1024
MANY, REPORT_S = 20, 60.0  # wrong tokens worth an event, and seconds to the next


@dataclass(slots=True)
class _Count:
    """A count of wrong tokens that decays every second."""

    free: float
    per_s: float
    count: float = 0.0
    at_s: float = 0.0

    def add(self, number: float, now_s: float) -> float:
        """Add to the count and return it."""
        left = max(0.0, self.count - (now_s - self.at_s) * self.per_s)
        self.count, self.at_s = min(left + number, self.free + MOST_COUNTED), now_s
        return self.count


@dataclass(slots=True, eq=False)
class Guesses:
    """Counts wrong tokens.

    Attributes:
        now_s: a clock.
        report: called with a line for operators after many wrong tokens.
    """

    now_s: Callable[[], float]
    report: Callable[[str], object] = lambda line: None
    _counts: OrderedDict[str, _Count] = field(default_factory=OrderedDict)
    _all: _Count = field(default_factory=lambda: _Count(FREE_IN_ALL, FORGIVEN_IN_ALL_PER_S))
    _waiting: dict[str, int] = field(default_factory=dict)
    _known: OrderedDict[bytes, None] = field(default_factory=OrderedDict)
    _salt: bytes = field(default_factory=lambda: secrets.token_bytes(16))
    _unreported: int = 0
    _reported_s: float | None = None

    def wait_s(self, address: str, token: str) -> float:
        """Return how long a token of an address waits before it is compared."""
        if self._digest(address, token) in self._known:
            return 0.0
        now_s = self.now_s()
        if self._all.add(0.0, now_s) >= FREE_IN_ALL:
            return LONGEST_WAIT_S
        count = self._counts.get(address)
        over = -1.0 if count is None else count.add(0.0, now_s) - FREE
        return 0.0 if over < 0 else min(LONGEST_WAIT_S, FIRST_WAIT_S * 2.0**over)

    def enter(self, address: str) -> bool:
        """Return whether one more request of an address may wait; if so, call `leave` after it."""
        waiting = self._waiting.get(address, 0)
        if waiting >= WAITING:
            return False
        self._waiting[address] = waiting + 1
        return True

    def leave(self, address: str) -> None:
        """End the wait of a request."""
        self._waiting[address] -= 1
        if not self._waiting[address]:
            del self._waiting[address]

    def right(self, address: str, token: str) -> None:
        """Remember that an address has shown a right token."""
        digest = self._digest(address, token)
        self._known.pop(digest, None)
        self._known[digest] = None
        while len(self._known) > MAX_KNOWN:
            self._known.popitem(last=False)

    def wrong(self, address: str) -> None:
        """Count a wrong token of an address."""
        now_s = self.now_s()
        self._all.add(1.0, now_s)
        count = self._counts.pop(address, None) or _Count(FREE, FORGIVEN_PER_S)
        count.add(1.0, now_s)
        self._counts[address] = count
        while len(self._counts) > MAX_KNOWN:
            self._counts.popitem(last=False)
        self._unreported += 1
        due = self._reported_s is None or now_s >= self._reported_s + REPORT_S
        if self._unreported >= MANY and due:
            self.report(
                f"{self._unreported} wrong tokens, the last from {address}: somebody guesses; "
                f"a new token waits up to {LONGEST_WAIT_S:g} s, one already accepted does not"
            )
            self._unreported, self._reported_s = 0, now_s

    def _digest(self, address: str, token: str) -> bytes:
        said = f"{address} {token}".encode(errors="replace")
        return hmac.digest(self._salt, said, "sha256")


PROTOCOL = "e3pose"  # of WebSockets; a token may come as a second one, as browsers send no header
TOKEN_PROTOCOL = "e3pose.token."
OPEN_PATHS = frozenset(FILES) | {"/favicon.ico"}  # they hold nothing of the site
WRITE_PREFIX, PICTURE_PREFIX = "/api/control", "/api/pictures"
READS_PER_S, READ_BURST = 50.0, 100.0
WRITES_PER_S, WRITE_BURST = 5.0, 10.0
MAX_BODY_BYTES = 4096
LOOK_S = 1.0  # between two looks whether an answer goes to somebody who may have it
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


@dataclass(frozen=True, slots=True)
class Client:
    """The sender of a request.

    Attributes:
        address: that its rates are kept by.
        secure: whether it reaches this server by https.
    """

    address: str
    secure: bool = False

    @property
    def scheme(self) -> str:
        """Of the addresses that it sees."""
        return "https" if self.secure else "http"


class Judge(Protocol):
    """Knows tokens."""

    def scope(self, token: str) -> Scope | None:
        """Return the scope of a token; None for an unknown one."""
        ...


J = TypeVar("J", bound=Judge, covariant=True)


@dataclass(slots=True, eq=False)
class Rules(Generic[J]):
    """The access rules.

    Attributes:
        tokens: of the site.
        hosts: names by which this server is reached; addresses need not be named, as no foreign
            page can have the browser believe that an address is its own.
        open_reading: whether reading needs no token: on loopback alone.
        open_pictures: whether pictures of cameras need no more than reading does.
        printed_by: the command that prints the tokens.
        secure: whether it is reached by https.
        proxies: addresses of reverse proxies, which say for whom they ask.
        reads: how often each client may read.
        writes: how often each may change something.
        guesses: slows down clients with wrong tokens.
        open_paths: that hold nothing which needs a token.
        personal: whether each token is one person's, who then has one rate wherever they are.
    """

    tokens: J
    hosts: frozenset[str]
    open_reading: bool
    secure: bool = False
    proxies: frozenset[str] = frozenset()
    open_pictures: bool = False
    printed_by: str = "e3pose view"
    reads: Rate = field(default_factory=lambda: Rate(READS_PER_S, READ_BURST, time.monotonic))
    writes: Rate = field(default_factory=lambda: Rate(WRITES_PER_S, WRITE_BURST, time.monotonic))
    guesses: Guesses = field(default_factory=lambda: Guesses(time.monotonic))
    open_paths: frozenset[str] = OPEN_PATHS
    personal: bool = False

    def client_of(self, address: str, headers: Mapping[str, str]) -> Client:
        """Return the sender of a request.

        Args:
            address: that it comes from.
            headers: by lower-case name; they count where the address is that of a proxy.
        """
        if address not in self.proxies:
            return Client(network_of(address), self.secure)
        secure = headers.get("x-forwarded-proto", "http").strip().lower() == "https"
        # Each proxy appends who asked it; what stands before the first foreign one is hearsay.
        for said in reversed(headers.get("x-forwarded-for", "").split(",")):
            if said.strip() and said.strip() not in self.proxies:
                return Client(network_of(said.strip()[:64]), secure)
        return Client(network_of(address), secure)

    def judge(
        self, path: str, headers: Mapping[str, str], client: Client
    ) -> tuple[Scope | None, Refusal | None]:
        """Return the scope of a request, and why it is refused; None if it is not.

        Args:
            path: of the request.
            headers: by lower-case name.
            client: who sends it.
        """
        host = headers.get("host", "")
        if not is_own_host(host, self.hosts):
            return None, Refusal(421, f"host {host[:80]!r} is not this server: see [view] hosts")
        if refusal := self._foreign(path, headers, f"{client.scheme}://{host}"):
            return None, refusal
        if refusal := _large(headers):
            return None, refusal
        if self.open_reading and not self.proxies and "x-forwarded-for" in headers:
            return None, Refusal(403, "asked through a proxy: see [view] proxies")
        if path in self.open_paths:
            return None, _late(self.reads.wait_s(client.address))
        scope: Scope | None = "read" if self.open_reading else None
        who = client.address
        if token := token_of(headers):
            found = self.tokens.scope(token)
            if found is None:
                self.guesses.wrong(client.address)
                return None, Refusal(401, "wrong token", BEARER)
            self.guesses.right(client.address, token)
            # Others at the same address do not use up the rate of who has a token.
            who, scope = token if self.personal else f"{found} {client.address}", found
        if scope is None:
            return None, Refusal(401, f"a token is needed: `{self.printed_by}` prints it", BEARER)
        writes = path.startswith(WRITE_PREFIX)
        guarded = path.startswith(PICTURE_PREFIX) and not self.open_pictures
        if (writes or guarded) and scope != "write":
            why = f"the token for writing is needed: `{self.printed_by}` prints it"
            return scope, Refusal(403 if token else 401, why, {} if token else BEARER)
        return scope, _late((self.writes if writes else self.reads).wait_s(who))

    def _foreign(self, path: str, headers: Mapping[str, str], own: str) -> Refusal | None:
        origin = headers.get("origin")
        if origin is not None and origin.lower() != own.lower():
            return Refusal(403, f"origin {origin[:80]!r} is not this page")
        # A link that somebody follows to the page is not a request by the page it stands on.
        site = headers.get("sec-fetch-site", "none")
        if site not in ("none", "same-origin") and path not in self.open_paths:
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
    """Access control as an ASGI application around another."""

    def __init__(self, app: ASGIApp, rules: Rules[Judge]) -> None:
        """Stand before an application."""
        self.app, self.rules = app, rules

    async def __call__(self, connection: Connection, receive: Receive, send: Send) -> None:
        """Pass a request on, with its `scope` in the state, or refuse it."""
        if connection["type"] not in ("http", "websocket"):
            return await self.app(connection, receive, send)
        headers = Headers(scope=connection)
        client = self.rules.client_of(str((connection.get("client") or ("", 0))[0]), headers)
        refusal = await self._delay(client.address, token_of(headers))
        scope = None
        if refusal is None:
            scope, refusal = self.rules.judge(connection["path"], headers, client)
        if refusal is None:
            connection.setdefault("state", {}).update(scope=scope, client=client.address)
            send = _with_headers(self._while_let_in(connection, token_of(headers), send))
            return await self.app(connection, receive, send)
        if connection["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": CLOSED, "reason": refusal.why})
            return None
        answer = JSONResponse(
            {"detail": refusal.why}, refusal.status, {**HEADERS, **refusal.headers}
        )
        return await answer(connection, receive, send)

    def _while_let_in(self, connection: Connection, token: str, send: Send) -> Send:
        """Return a `send` that ends an answer when its token is revoked."""
        looked_s, over = time.monotonic(), False

        async def forward(message: Message) -> None:
            nonlocal looked_s, over
            if token and not over and time.monotonic() - looked_s > LOOK_S:
                looked_s, over = time.monotonic(), self.rules.tokens.scope(token) is None
                if over and connection["type"] == "http":  # its reader hears that it is whole
                    await send({"type": "http.response.body", "body": b""})
                elif over:
                    await send({"type": "websocket.close", "code": CLOSED, "reason": "revoked"})
            if over and connection["type"] == "websocket":
                raise RuntimeError("revoked")
            if not over:
                await send(message)

        return forward

    async def _delay(self, address: str, token: str) -> Refusal | None:
        """Wait before a token is compared, while tokens are guessed."""
        guesses = self.rules.guesses
        wait_s = guesses.wait_s(address, token) if token else 0.0
        if not wait_s:
            return None
        if not guesses.enter(address):
            return _late(wait_s)
        try:
            await asyncio.sleep(wait_s)
        finally:
            guesses.leave(address)
        return None


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
