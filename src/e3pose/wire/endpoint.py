"""Where a program of a site listens, and where others find it."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from typing import Literal

from e3pose.base.errors import InputError
from e3pose.base.table import convert

MAX_LENGTH = 300


@dataclass(frozen=True, slots=True)
class Endpoint:
    """Where a program listens; as text `tls/HOST:PORT` or `tcp/HOST:PORT`.

    Attributes:
        protocol: `tls` is encrypted.
        host: name or address; one of IPv6 in brackets.
        port: 0 for any that is free.
    """

    protocol: Literal["tcp", "tls"]
    host: str
    port: int

    def __str__(self) -> str:
        """Return it as a person writes it."""
        return f"{self.protocol}/{self.place}"

    @property
    def place(self) -> str:
        """`HOST:PORT`."""
        return f"{self.host}:{self.port}"

    @property
    def encrypted(self) -> bool:
        """Whether programs need certificates there."""
        return self.protocol == "tls"

    @property
    def address(self) -> tuple[str, int]:
        """Host and port as sockets take them."""
        return self.host.strip("[]"), self.port

    @property
    def here_alone(self) -> bool:
        """Whether only this machine can reach it."""
        return is_loopback(self.host)


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach the host."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def read_endpoint(found: object, thing: str = "") -> Endpoint:
    """Return the endpoint that a text names.

    Args:
        found: what somebody wrote.
        thing: the setting or option that it is of.

    Raises:
        InputError: for anything but `tls/HOST:PORT` and `tcp/HOST:PORT`.
    """
    words = convert(str, found)
    protocol, _, place = words.partition("/")
    host, _, port = place.rpartition(":")
    numbered = port.isascii() and port.isdigit() and len(port) <= 5 and int(port) <= 65535
    fits = numbered and host and len(words) <= MAX_LENGTH and not any(c in place for c in " /?#;")
    if protocol == "tls" and fits:
        return Endpoint("tls", host, int(port))
    if protocol == "tcp" and fits:
        return Endpoint("tcp", host, int(port))
    wanted = "tls/HOST:PORT or tcp/HOST:PORT, such as tls/edge.local:7447"
    raise InputError(thing, repr(words[:100]), wanted)


def read_endpoints(found: object) -> tuple[Endpoint, ...]:
    """Return several, in a list; raise `InputError` as `read_endpoint` does."""
    return tuple(read_endpoint(each) for each in convert(tuple[str, ...], found))


def read_host_port(found: object, thing: str = "", example: str = "127.0.0.1:8470") -> Endpoint:
    """Return where a page listens, or a stream is sent: `HOST:PORT`.

    Args:
        found: what somebody wrote.
        thing: the setting or option that it is of.
        example: an address such as is expected.

    Raises:
        InputError: for anything but `HOST:PORT`.
    """
    words = convert(str, found)
    try:
        return read_endpoint(f"tcp/{words}")
    except InputError:
        raise InputError(thing, repr(words[:100]), f"HOST:PORT, such as {example}") from None
