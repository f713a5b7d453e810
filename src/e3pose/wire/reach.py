"""Whether a camera reaches its edge: its name, its port, its certificate, and its answer."""

from __future__ import annotations

import datetime
import socket
import ssl
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

from e3pose.base.clock import WallClock
from e3pose.base.errors import InputError, reason_of
from e3pose.wire import topics
from e3pose.wire.access import Link
from e3pose.wire.clock_exchange import exchange_time
from e3pose.wire.keys.folder import expired
from e3pose.wire.network import open_network
from e3pose.wire.offset import Exchange

CONNECT_S = 3.0
PAUSE_S = 0.1  # between two questions


@dataclass(frozen=True, slots=True)
class Reach:
    """The result of an attempt to reach the edge as a camera does.

    Attributes:
        outcome: `answered`, or what stops it: its host is `unknown`, nothing listens (`refused`),
            there is `no-route`, or the edge does not answer this camera (`silent`).
        reason: of `no-route`, in words of the system.
        exchange: of times with the edge that answered.
        expires: when its certificate does; None without one.
    """

    outcome: Literal["answered", "unknown", "refused", "no-route", "silent"]
    reason: str = ""
    exchange: Exchange | None = None
    expires: datetime.datetime | None = None


def reach_edge(link: Link, camera_id: str, timeout_s: float) -> Reach:
    """Try to reach an edge as a camera does.

    Args:
        link: how the camera joins.
        camera_id: of the camera.
        timeout_s: how long to wait for an answer.
    """
    expires = None
    if link.certificates is not None:
        from e3pose.wire.keys import authority

        expires = authority.expires(link.certificates.certificate.read_bytes())
    try:
        socket.create_connection(link.endpoint.address, CONNECT_S).close()
    except socket.gaierror:
        return Reach("unknown", expires=expires)
    except ConnectionRefusedError:
        return Reach("refused", expires=expires)
    except OSError as error:
        return Reach("no-route", reason_of(error), expires=expires)
    exchange = _ask_time(link, camera_id, timeout_s)
    return Reach("silent" if exchange is None else "answered", "", exchange, expires)


def expired_on_the_way(link: Link) -> str:
    """Return which certificate of a camera or its edge has expired, when, and what to do.

    The edge's is what it shows to anybody who connects; empty where none is known to have expired.
    """
    from e3pose.wire.keys import authority

    if link.certificates is None:
        return ""
    with suppress(OSError, InputError):
        if problem := expired(link.certificates):
            return problem
        shown = ssl.get_server_certificate(link.endpoint.address, timeout=CONNECT_S)
        until = authority.expires(shown.encode())
        if until < datetime.datetime.now(datetime.timezone.utc):
            return (
                f"the certificate of the edge at {link.endpoint} expired on {until:%Y-%m-%d %H:%M} "
                "UTC: `e3pose keys renew edge` there makes a new one; restart the edge"
            )
    return ""


def _ask_time(link: Link, camera_id: str, timeout_s: float) -> Exchange | None:
    """Exchange times with the edge, as a camera does; None if it does not answer."""
    transport, clock = open_network(link), WallClock()
    topic = topics.of_camera(link.site, camera_id, "clock")
    end_s, pause = time.monotonic() + timeout_s, threading.Event()
    try:
        while True:
            found = exchange_time(transport, topic, camera_id, clock, lambda why: None)
            if found is not None or time.monotonic() >= end_s:
                return found
            pause.wait(PAUSE_S)
    finally:
        transport.close()
