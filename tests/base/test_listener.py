"""Bounds of connections, with real sockets on loopback."""

from __future__ import annotations

import asyncio
import datetime
import gc
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest
from tests.cases import each_case
from tests.waiting import eventually

from e3pose.base.listener import Bounds, Listener, network_of, open_socket
from e3pose.wire.keys.authority import make_authority, make_certificate

FLOOD = Path(__file__).parents[1] / "flood.py"


class Echo(asyncio.Protocol):
    """Says back what it hears; one that heard something is at work."""

    def __init__(self) -> None:
        self.waiting_since_s: float | None = asyncio.get_running_loop().time()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self.waiting_since_s = None
        self.transport.write(data)


class Idle(Echo):
    """Says back what it hears, and waits again at once."""

    def data_received(self, data: bytes) -> None:
        self.transport.write(data)


@contextmanager
def echo(
    bounds: Bounds, make: type[Echo] = Echo, secure: ssl.SSLContext | None = None
) -> Iterator[int]:
    """Serve on a thread and yield the port."""
    listening = open_socket("127.0.0.1", 0)
    loop = asyncio.new_event_loop()
    ended = threading.Event()

    async def serve() -> None:
        accepting = asyncio.ensure_future(Listener(listening, make, bounds, secure).run())
        while not ended.is_set():
            await asyncio.sleep(0.01)
        accepting.cancel()

    thread = threading.Thread(target=lambda: loop.run_until_complete(serve()), daemon=True)
    thread.start()
    try:
        yield listening.getsockname()[1]
    finally:
        ended.set()
        thread.join()
        loop.run_until_complete(asyncio.sleep(0.01))  # what was cancelled ends
        loop.close()
        listening.close()


def connected(port: int) -> socket.socket:
    made = socket.create_connection(("127.0.0.1", port), timeout=20.0)
    made.setblocking(True)
    return made


def answers(made: socket.socket) -> bool:
    try:
        made.sendall(b"hello")
        return made.recv(5) == b"hello"
    except OSError:
        return False


def ended(made: socket.socket) -> bool:
    """Return whether the other side closes a connection that says nothing."""
    made.settimeout(20.0)
    try:
        return made.recv(1) == b""
    except ConnectionError:
        return True


def test_who_waits_longest_makes_room_and_who_works_stays() -> None:
    with echo(Bounds(4, 4)) as port, ExitStack() as stack:
        at_work = stack.enter_context(connected(port))
        assert answers(at_work)
        idle = [stack.enter_context(connected(port)) for _ in range(3)]
        assert answers(newcomer := stack.enter_context(connected(port)))
        assert ended(idle[0]) and answers(at_work)
        assert answers(idle[1]) and answers(idle[2]) and answers(newcomer)
        # All are at work now: nobody makes room.
        refused = stack.enter_context(connected(port))
        assert not answers(refused) and answers(at_work)


def test_one_address_leaves_places_for_others_and_a_proxy_may_have_all() -> None:
    for proxies, comes_in in ((frozenset[str](), False), (frozenset({"127.0.0.1"}), True)):
        with echo(Bounds(4, 2, proxies=proxies)) as port, ExitStack() as stack:
            assert all(answers(stack.enter_context(connected(port))) for _ in range(2))
            assert answers(stack.enter_context(connected(port))) == comes_in


def test_connection_that_says_nothing_ends() -> None:
    with (
        echo(Bounds(4, 4, request_s=0.3)) as port,
        connected(port) as silent,
        connected(port) as at_work,
    ):
        assert answers(at_work)
        begun_s = time.monotonic()
        assert ended(silent) and time.monotonic() - begun_s < 15
        assert answers(at_work)


def test_flood_of_silent_connections_leaves_no_files_open() -> None:
    with echo(Bounds(8, 8)) as port, ExitStack() as stack:
        silent = [stack.enter_context(connected(port)) for _ in range(100)]
        assert eventually(lambda: answers(stack.enter_context(connected(port))))
        assert all(ended(one) for one in silent[:90])


@pytest.mark.slow
def test_flood_of_handshakes_leaves_those_of_others_alone(tmp_path: Path) -> None:
    now = datetime.datetime.now(datetime.timezone.utc)
    authority = make_authority("house", now)
    for name, part in zip(
        ("pem", "key"), make_certificate(*authority, "hub", ["localhost"], now), strict=True
    ):
        (tmp_path / f"hub.{name}").write_bytes(part)
    secure = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    secure.load_cert_chain(tmp_path / "hub.pem", tmp_path / "hub.key")
    trusting = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    with echo(Bounds(64, 8, request_s=30.0), Idle, secure) as port:
        words = [sys.executable, str(FLOOD), f"127.0.0.1:{port}", "", ""]
        with subprocess.Popen(words, stdout=subprocess.PIPE) as flooding:
            try:
                assert flooding.stdout is not None and flooding.stdout.readline()
                for _ in range(60):
                    with connected(port) as raw, trusting.wrap_socket(raw) as one:
                        assert answers(one)
            finally:
                flooding.kill()


def test_connection_that_comes_as_the_port_closes_does_not_stay_open() -> None:
    async def close_after_turns(listening: socket.socket, turns: int) -> None:
        accepting = asyncio.ensure_future(Listener(listening, Echo, Bounds(5, 5)).run())
        await asyncio.sleep(0.01)
        with socket.create_connection(listening.getsockname(), timeout=5) as client:
            for _ in range(turns):
                await asyncio.sleep(0)
            accepting.cancel()
            with suppress(asyncio.CancelledError):
                await accepting
            listening.close()
            await asyncio.sleep(0)
            client.setblocking(False)
            ends = asyncio.get_running_loop().sock_recv(client, 1)
            with suppress(ConnectionResetError):
                assert await asyncio.wait_for(ends, 5) == b""

    for turns in range(8):
        with open_socket("127.0.0.1", 0) as listening:
            asyncio.run(close_after_turns(listening, turns))
    gc.collect()  # a socket that is left open is a warning, and so an error


@each_case(
    ("address", "network"),
    [
        ("10.0.0.7", "10.0.0.7"),
        ("2001:db8::1", "2001:db8::/64"),
        ("2001:db8::ffff:2", "2001:db8::/64"),
        ("::ffff:10.0.0.7", "10.0.0.7"),
        ("fe80::1%eth0", "fe80::/64"),
        ("unix", "unix"),
    ],
)
def test_addresses_of_one_ipv6_network_are_one(address: str, network: str) -> None:
    assert network_of(address) == network
