"""Accept connections to a port: so many in all and from one address, none silent for long.

An idle connection costs nothing to open, so places are never lost to one: when they run out, the
connection that has waited longest for a request is closed for the new one.
"""

from __future__ import annotations

import asyncio
import ipaddress
import socket
import ssl
from collections.abc import Callable, Container
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from e3pose.base.system import claim_address

REQUEST_S = 10.0  # for the TLS handshake, and then for each whole request
SWEEP_S = 0.5
RETRY_S = 0.1  # after the system could not accept a connection


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits on the connections of a port.

    Attributes:
        connections: in all.
        per_address: from one address.
        request_s: seconds that a client has to complete a request, and to take some of an answer.
        proxies: addresses of reverse proxies, which only the bound in all holds for.
    """

    connections: int
    per_address: int
    request_s: float = REQUEST_S
    proxies: frozenset[str] = frozenset()


def network_of(address: str) -> str:
    """Return the network that counts as one address: an IPv4 address, or an IPv6 address's /64."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(found, ipaddress.IPv6Address):
        if found.ipv4_mapped is not None:
            return str(found.ipv4_mapped)
        return str(ipaddress.ip_network((found, 64), strict=False))
    return str(found)


def is_own_host(host: str, names: Container[str]) -> bool:
    """Return whether no foreign page can have had the browser use this host.

    Args:
        host: of a request, with or without a port.
        names: ours, lower case; addresses need not be named, as no foreign page can have the
            browser believe that an address is its own.
    """
    name = host.rpartition(":")[0] if host.rpartition(":")[2].isdigit() else host
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return name.lower() in names
    return True


def open_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens; raise `OSError` where that is not possible."""
    family = socket.AF_INET6 if host.startswith("[") else socket.AF_INET
    # Named TCP: asyncio lets only sockets that are send small parts at once, not 40 ms later.
    listening = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        claim_address(listening)
        listening.bind((host.strip("[]"), port))
        listening.listen(128)
    except OSError:
        listening.close()
        raise
    return listening


def port_in_use(port: int, remedy: str) -> str:
    """Return the words for a port that another program has, and what to do about it."""
    found = f"`ss -ltnp 'sport = :{port}'` names it"
    return f"port {port} is in use: stop the program that has it ({found}), {remedy}"


@dataclass(slots=True, eq=False)
class _Held:
    """An accepted connection."""

    address: str
    accepted: socket.socket
    since_s: float
    opening: asyncio.Task[None] | None = None
    transport: Any = None
    owned: bool = False  # by asyncio, which closes it: the next would be deaf if we did

    def opened(self) -> None:
        if not self.owned:
            self.accepted.close()

    def gone(self) -> bool:
        return self.accepted.fileno() < 0

    def waiting_since_s(self) -> float | None:
        """Return since when it waits for its client; None while a request is answered."""
        if self.transport is None:
            return self.since_s
        since_s: float | None = getattr(self.transport.get_protocol(), "waiting_since_s", None)
        return since_s

    def close(self) -> None:
        if self.transport is not None:
            self.transport.abort()
            return
        if self.opening is not None:
            self.opening.cancel()
        with suppress(OSError):  # the client is gone
            self.accepted.shutdown(socket.SHUT_RDWR)  # a handshake that has just ended ends too


@dataclass(eq=False)
class Listener:
    """Accepts connections for as long as `run` does.

    Attributes:
        listening: the socket.
        make: returns the protocol of a new connection. Its attribute `waiting_since_s` is the
            loop's time since which it waits for its client, or None while it works; a protocol
            without one always works.
        bounds: see `Bounds`.
        secure: of TLS; None for none.
    """

    listening: socket.socket
    make: Callable[[], asyncio.BaseProtocol]
    bounds: Bounds
    secure: ssl.SSLContext | None = None
    _held: list[_Held] = field(default_factory=list)

    async def run(self) -> None:
        """Accept connections until cancelled; then close the open ones."""
        loop = asyncio.get_running_loop()
        self.listening.setblocking(False)
        sweeping = loop.create_task(self._sweep())
        try:
            while True:
                await asyncio.sleep(0)  # clients that connect without end leave others a turn
                try:
                    accepted, address = await self._accept()
                except OSError:  # no file left, or the client is gone already
                    await asyncio.sleep(RETRY_S)
                    continue
                self._take(accepted, network_of(str(address[0])))
        finally:
            sweeping.cancel()
            for one in self._held:
                one.close()

    async def _accept(self) -> tuple[socket.socket, Any]:
        """Return the next connection.

        Not by `sock_accept`: one that comes just as that is cancelled stays open, and nobody's.
        """
        loop = asyncio.get_running_loop()
        while True:
            with suppress(BlockingIOError):
                return self.listening.accept()
            ready = asyncio.Event()
            try:
                loop.add_reader(self.listening, ready.set)
            except NotImplementedError:  # on Windows, where `sock_accept` loses none
                return await loop.sock_accept(self.listening)
            try:
                await ready.wait()
            finally:
                loop.remove_reader(self.listening)

    def _take(self, accepted: socket.socket, address: str) -> None:
        self._held = [one for one in self._held if not one.gone()]
        same = [one for one in self._held if one.address == address]
        full: list[_Held] = []
        if len(same) >= self.bounds.per_address and address not in self.bounds.proxies:
            full = same
        elif len(self._held) >= self.bounds.connections:
            full = self._held
        if full and not self._close_one(full):
            accepted.close()
            return
        loop = asyncio.get_running_loop()
        one = _Held(address, accepted, loop.time())
        one.opening = loop.create_task(self._open(one))
        one.opening.add_done_callback(lambda _: one.opened())
        self._held.append(one)

    def _close_one(self, held: list[_Held]) -> bool:
        """Close the connection that has waited longest; return whether there is one."""
        waiting = [(since_s, one) for one in held if (since_s := one.waiting_since_s()) is not None]
        if not waiting:
            return False
        _, oldest = min(waiting, key=lambda pair: pair[0])
        oldest.close()
        self._held.remove(oldest)
        return True

    async def _open(self, one: _Held) -> None:
        loop, one.owned = asyncio.get_running_loop(), True
        handshake_s = None if self.secure is None else self.bounds.request_s
        with suppress(OSError):  # ssl.SSLError is one, and so is a timeout
            one.transport, _ = await loop.connect_accepted_socket(
                self.make, one.accepted, ssl=self.secure, ssl_handshake_timeout=handshake_s
            )

    async def _sweep(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(SWEEP_S)
            self._held = [one for one in self._held if not one.gone()]
            latest_s = loop.time() - self.bounds.request_s
            for one in self._held:
                since_s = one.waiting_since_s()
                if since_s is not None and since_s < latest_s:
                    one.close()
