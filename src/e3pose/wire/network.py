"""The network transport: Zenoh, with the edge as router."""

from __future__ import annotations

import errno
import json
import re
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import zenoh

from e3pose.base.errors import InputError
from e3pose.base.listener import port_in_use
from e3pose.base.system import claim_address
from e3pose.wire.access import Link, Roll, zenoh_config
from e3pose.wire.endpoint import Endpoint
from e3pose.wire.transport import Answer, Presence, Receive

RETRY_S = 0.2  # between two attempts of a client to join


class NetworkTransport:
    """See `Transport`. Make it with `open_network`.

    A client of Zenoh opens only where an edge answers. It then joins on a thread of its own: until
    it has, what is published is dropped, and what is declared is declared once it has joined.
    """

    def __init__(self, session: Any | None, join: Callable[[], Any] | None = None) -> None:
        """Own a session, or open it in the background.

        Args:
            session: of Zenoh; None to open it.
            join: returns one, or raises `zenoh.ZError`; it is called until it returns one.
        """
        self._session: Any = session
        self._declared: list[Any] = []  # what is not held is undeclared
        self._due: list[Callable[[Any], Any]] = []
        self._lock = threading.Lock()
        self._closed = threading.Event()
        if session is None and join is not None:
            # No daemon: an interpreter that ends inside of Zenoh aborts.
            threading.Thread(target=self._join, args=(join,), name="join", daemon=False).start()

    def _join(self, join: Callable[[], Any]) -> None:
        session = None
        while session is None:
            try:
                session = join()
            except zenoh.ZError:
                if self._closed.wait(RETRY_S) or not threading.main_thread().is_alive():
                    return
        with self._lock:
            if not self._closed.is_set():
                self._session = session
                self._declared += [declare(session) for declare in self._due]
                self._due.clear()
                return
        session.close()

    def _declare(self, declare: Callable[[Any], Any]) -> None:
        with self._lock:
            if self._session is None:
                self._due.append(declare)
            else:
                self._declared.append(declare(self._session))

    def publish(self, topic: str, payload: bytes) -> None:
        """See `Transport.publish`: dropped, not waited for, where the network is full."""
        if (session := self._session) is None:
            return
        with suppress(zenoh.ZError):  # closed meanwhile: lost, like anything that cannot be sent
            session.put(
                topic, payload, congestion_control=zenoh.CongestionControl.DROP, express=True
            )

    def subscribe(self, topic: str, receive: Receive) -> None:
        """See `Transport.subscribe`."""

        def take(sample: Any) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                receive(str(sample.key_expr), sample.payload.to_bytes())

        self._declare(
            lambda session: session.declare_subscriber(
                topic,
                take,
                allowed_origin=zenoh.Locality.REMOTE,  # a program does not hear itself
            )
        )

    def ask(self, topic: str, payload: bytes, timeout_s: float) -> bytes | None:
        """See `Transport.ask`."""
        if (session := self._session) is None or session.is_closed():
            return None
        for reply in session.get(topic, payload=payload, timeout=timeout_s):
            if reply.ok is not None:
                return bytes(reply.ok.payload.to_bytes())
        return None

    def answer(self, topic: str, answer: Answer) -> None:
        """See `Transport.answer`."""

        def reply(query: Any) -> None:
            with query:
                payload = b"" if query.payload is None else query.payload.to_bytes()
                answered = answer(str(query.key_expr), payload)
                if answered is not None:
                    query.reply(query.key_expr, answered)

        self._declare(lambda session: session.declare_queryable(topic, reply))

    def be_present(self, topic: str) -> None:
        """See `Transport.be_present`."""
        self._declare(lambda session: session.liveliness().declare_token(topic))

    def watch(self, topic: str, presence: Presence) -> None:
        """See `Transport.watch`."""

        def notify(sample: Any) -> None:
            presence(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        self._declare(
            lambda session: session.liveliness().declare_subscriber(topic, notify, history=True)
        )

    def connected(self) -> bool:
        """See `Transport.connected`."""
        if (session := self._session) is None or session.is_closed():
            return False
        return bool(session.info.routers_zid() or session.info.peers_zid())

    def close(self) -> None:
        """See `Transport.close`."""
        with self._lock:
            self._closed.set()
            self._due.clear()
            self._declared.clear()
        if self._session is not None and not self._session.is_closed():
            self._session.close()


def open_network(link: Link, roll: Roll | None = None) -> NetworkTransport:
    """Join the site; a camera or viewer that finds no edge keeps trying in the background.

    Args:
        link: how to join.
        roll: who may join, see `zenoh_config`.

    Raises:
        InputError: when the endpoint or a certificate cannot be used.
    """
    zenoh.init_log_from_env_or("off")
    text = json.dumps(zenoh_config(link, roll))
    try:
        config = zenoh.Config.from_json5(text)
        if link.role == "viewer":
            return NetworkTransport(None, lambda: zenoh.open(config))
        return NetworkTransport(zenoh.open(config))
    except zenoh.ZError as error:
        raise InputError(f"endpoint {link.endpoint}: {_reason(link, str(error))}") from None


def check_port(endpoint: Endpoint) -> None:
    """Raise `InputError` if another program listens at an endpoint of this machine."""
    host, port = endpoint.address
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError:
        return  # said when it is opened
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        claim_address(probe)
        try:
            probe.bind(address)
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise InputError(f"endpoint {endpoint}: {_in_use(port)}") from None


def _in_use(port: int) -> str:
    return port_in_use(port, "such as another run of this site, or choose another port")


def _reason(link: Link, said: str) -> str:
    """Translate an error of Zenoh into the reason and what to do."""
    host, port = link.endpoint.host, link.endpoint.port
    if "os error 98" in said:
        return _in_use(port)
    if "os error 99" in said:
        return f"{host} is no address of this machine, expected one of its own or 0.0.0.0"
    # Zenoh names the places in its source where it failed.
    plain = re.sub(r"\s*(?:\[|\]|at /\S+\.rs:\d+\.?)\s*", " ", " ".join(said.split()))
    return f"cannot be used: {plain.strip()[:300]}"
