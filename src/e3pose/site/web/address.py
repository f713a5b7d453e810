"""Where the page of a site is, without what serves it: for programs that start its program."""

from __future__ import annotations

import errno
import socket
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from e3pose.base.child_process import PASSES
from e3pose.base.errors import InputError
from e3pose.base.listener import open_socket, port_in_use
from e3pose.settings.resolved import ResolvedSite
from e3pose.settings.site_file import DEFAULT_LISTEN, SiteTable
from e3pose.site.follow import ANY_HOST
from e3pose.site.up import Program, Role, view_command
from e3pose.site.web.tokens import open_tokens
from e3pose.wire.endpoint import is_loopback, read_host_port

PORTS_TRIED = 20  # after the default one


@dataclass(frozen=True, slots=True)
class Address:
    """Where a view listens, and how it is reached.

    Attributes:
        host: name or address.
        port: of it; 0 for a free one.
        certificate: of https; None for plain http.
        key: of the certificate.
        hosts: names by which browsers reach it.
    """

    host: str
    port: int
    certificate: Path | None
    key: Path | None
    hosts: frozenset[str]

    @property
    def url(self) -> str:
        """Of its page."""
        shown = "localhost" if self.host in ANY_HOST else self.host
        return f"{'http' if self.certificate is None else 'https'}://{shown}:{self.port}/"

    def is_open(self, site: SiteTable) -> bool:
        """Return whether reading needs no token; behind a proxy, those here are from anywhere."""
        return is_loopback(self.host) and not site.view.proxies


def address_of(site: SiteTable, listen: str | None = None) -> Address:
    """Return where the view of a site listens.

    Args:
        site: its file.
        listen: in place of the file's.

    Raises:
        InputError: for an address beyond this machine that would be served in plain http.
    """
    table = site.view
    at = table.listen if listen is None else read_host_port(listen, "--listen")
    host, port = at.host, at.port
    hosts = {"localhost", host.lower(), *(name.lower() for name in table.hosts)}
    if at.here_alone:
        return Address(host, port, None, None, frozenset(hosts))
    hosts |= {socket.gethostname().lower(), socket.getfqdn().lower()}
    certificate = key = None
    if site.link.keys is not None:
        certificate, key = (site.link.keys / name for name in ("edge.pem", "edge.key"))
    if certificate is None or key is None or not (certificate.is_file() and key.is_file()):
        if not table.insecure:
            raise InputError(
                "view.listen" if listen is None else "--listen",
                f"{at.place}, plain http beyond this machine",
                "127.0.0.1:PORT, `keys` under [link] for https, or insecure = true under [view]",
                str(site.path),
            )
        certificate = key = None
    return Address(host, port, certificate, key, frozenset(hosts))


def listening_at(
    host: str, port: int, advice: str = "or choose another with --listen"
) -> socket.socket:
    """Return a socket that listens where `--listen` says.

    Args:
        host: name or address of this machine.
        port: of it; 0 for a free one.
        advice: what else to do where the port is taken.

    Raises:
        InputError: naming a port that is taken, or an address of another machine.
    """
    try:
        return open_socket(host, port)
    except OSError as error:
        if error.errno != errno.EADDRINUSE:
            raise InputError("--listen", f"{host}:{port}", "an address of this machine") from None
        raise InputError(port_in_use(port, advice)) from None


def take_port(
    site: SiteTable,
    listen: str | None = None,
    report: Callable[[str], object] = lambda line: None,
    fixed: bool = True,
) -> tuple[Address, socket.socket]:
    """Return where the view of a site listens, and the socket that has the port.

    Where the port is taken, it is the next free one, if nobody asked for that one.

    Args:
        site: its file.
        listen: in place of the file's.
        report: called with a line about another port.
        fixed: whether a port that the file or `listen` names is the only one.

    Raises:
        InputError: for a port that is taken, and as `address_of` does.
    """
    address = address_of(site, listen)
    asked = fixed and (listen is not None or site.view.listen is not DEFAULT_LISTEN)
    advice = "or choose another with --listen, or listen under [view] of the site file"
    last = address.port + (0 if asked or address.port == 0 else PORTS_TRIED)
    for port in range(address.port, min(last, 65535) + 1):
        try:
            listening = listening_at(address.host, port, advice)
        except InputError:
            if port == last:
                raise
            continue
        found = listening.getsockname()[1]
        if address.port not in (0, found):
            report(f"port {address.port} is in use: the page is at port {found}")
        return replace(address, port=found), listening
    raise AssertionError("the last port raises")


def view_program(
    site: ResolvedSite, logs: Path, report: Callable[[str], object], fixed: bool = True
) -> tuple[Program, Address]:
    """Return the program that serves the page of a site, and its address, whose port it has.

    Args:
        site: what its file says.
        logs: folder of its log.
        report: see `take_port`.
        fixed: likewise.
    """
    address, listening = take_port(site.file, report=report, fixed=fixed)
    options, passed = ["--socket", str(listening.fileno())], [listening]
    if not PASSES:
        options, passed = ["--listen", f"{address.host}:{address.port}"], []
        listening.close()
    command = view_command(site.file.path, *options)
    return Program("view", command, logs / "view.log", passed, role=Role.PAGE), address


def page_links(site: SiteTable, address: Address) -> list[str]:
    """Return the addresses of the pages, a line each, with their tokens.

    Args:
        site: its file.
        address: where its view listens.
    """
    tokens = open_tokens(site.view.tokens)
    token = "" if address.is_open(site) else f"#token={tokens.read}"
    return [
        f"See the site:     {address.url}{token}",
        f"Control the site: {address.url}#token={tokens.write}",
    ]
