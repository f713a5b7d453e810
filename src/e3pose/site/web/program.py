"""The program `e3pose view`: from a site file to a running web server."""

from __future__ import annotations

import asyncio
import errno
import socket
import threading
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import uvicorn

from e3pose.errors import InputError
from e3pose.settings.live import LiveSite
from e3pose.settings.site_file import SiteTable
from e3pose.site.follow import ANY_HOST, viewer_link
from e3pose.site.web.access import Rules
from e3pose.site.web.app import Site, make_app
from e3pose.site.web.control import Ask
from e3pose.site.web.feed import Feed
from e3pose.site.web.layout import describe
from e3pose.site.web.pictures import make_pictures
from e3pose.site.web.tokens import open_tokens
from e3pose.site.zones import Zones
from e3pose.store import Store
from e3pose.wire.access import is_loopback, split_endpoint
from e3pose.wire.network import open_network
from e3pose.wire.topics import of_camera, of_site
from e3pose.wire.transport import Transport

START_S = 20.0
END_S = 5.0
ASK_S = 3.0  # for the edge to answer
MAX_CONNECTIONS = 256
PING_S = 60.0  # for a browser on a busy machine to answer a ping
MAX_MESSAGE_BYTES = 4096  # of a WebSocket, to us


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


def address_of(site: SiteTable, listen: str | None = None) -> Address:
    """Return where the view of a site listens.

    Args:
        site: its file.
        listen: in place of the file's.

    Raises:
        InputError: for an address beyond this machine that would be served in plain http.
    """
    table, words = site.view, listen or site.view.listen
    try:
        _, host, port = split_endpoint(f"tcp/{words}")
    except InputError:
        raise InputError("--listen", repr(words[:100]), "HOST:PORT, 127.0.0.1:8470") from None
    hosts = {"localhost", host.lower(), *(name.lower() for name in table.hosts)}
    if is_loopback(host):
        return Address(host, port, None, None, frozenset(hosts))
    hosts |= {socket.gethostname().lower(), socket.getfqdn().lower()}
    certificate = key = None
    if site.link.keys is not None:
        certificate, key = (site.near(site.link.keys) / name for name in ("edge.pem", "edge.key"))
    if certificate is None or key is None or not (certificate.is_file() and key.is_file()):
        if not table.insecure:
            raise InputError(
                "view.listen" if listen is None else "--listen",
                f"{words}, plain http beyond this machine",
                "127.0.0.1:PORT, `keys` under [link] for https, or insecure = true under [view]",
                str(site.path),
            )
        certificate = key = None
    return Address(host, port, certificate, key, frozenset(hosts))


def page_links(site: SiteTable, address: Address) -> list[str]:
    """Return the addresses of the pages, a line each, with their tokens.

    Args:
        site: its file.
        address: where its view listens.
    """
    tokens = open_tokens(site.near(site.view.tokens))
    token = "" if is_loopback(address.host) else f"#token={tokens.read}"
    return [
        f"See the site:     {address.url}{token}",
        f"Control the site: {address.url}#token={tokens.write}",
    ]


class View:
    """A server at work, until it is closed. Use it as a context manager.

    Attributes:
        address: where it listens.
        url: of its page.
        rules: who may come in.
        tokens: who may read and write.
        feed: what it hands on.
    """

    def __init__(self, address: Address, rules: Rules, feed: Feed) -> None:
        """Describe a server; `open_view` starts one."""
        self.address, self.url = address, address.url
        self.rules, self.tokens, self.feed = rules, rules.tokens, feed
        self._stack = ExitStack()

    def __enter__(self) -> View:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def running(self) -> bool:
        """Return whether it serves."""
        return self._thread.is_alive()

    def serve(self, server: uvicorn.Server, listening: socket.socket) -> None:
        """Begin to serve on a thread of its own; return once it does."""
        self._thread = threading.Thread(
            target=lambda: asyncio.run(server.serve([listening])), name="view", daemon=True
        )
        self._thread.start()
        started = threading.Event()
        while not server.started and self._thread.is_alive():
            started.wait(0.01)

        def end() -> None:
            server.should_exit = True
            self._thread.join(END_S)
            server.force_exit = True
            self._thread.join(END_S)
            listening.close()

        self._stack.callback(end)

    def close(self) -> None:
        """End."""
        self._stack.close()


def open_view(
    live: LiveSite,
    listen: str | None = None,
    keys: Path | None = None,
    transport: Transport | None = None,
) -> View:
    """Serve a site over HTTP until the view is closed.

    Args:
        live: the site with its rig.
        listen: in place of the file's `HOST:PORT`.
        keys: folder of a viewer's certificate.
        transport: how to reach the edge; by default that of the site file.

    Raises:
        InputError: for a port that is taken, and all that is wrong in the file.
    """
    site = live.site
    address = address_of(site, listen)
    tokens = open_tokens(site.near(site.view.tokens))
    listening = _listen(address)
    address = replace(address, port=listening.getsockname()[1])
    rules = Rules(tokens, address.hosts, is_loopback(address.host), address.certificate is not None)
    feed = Feed(site.name, zones=Zones(site.zone))
    view = View(address, rules, feed)
    with ExitStack() as stack:
        stack.callback(listening.close)
        place = site.store_place
        operates = True
        if transport is None:
            link = viewer_link(site, keys, operates=True)
            files = link.certificates
            operates = files is None or files.certificate.name == "operator.pem"
            transport = open_network(link)
        stack.callback(transport.close)
        feed.listen(transport)
        body = describe(live)
        store, topic = None if place is None else Store(place), of_site(site.name, "control")

        def asking(topic: str) -> Ask:
            return lambda payload: transport.ask(topic, payload, ASK_S)

        pictures = None
        if site.view.pictures and operates:
            names = {i: of_camera(site.name, i, "picture") for i in live.rig.camera_ids}
            asks = {camera_id: asking(topic) for camera_id, topic in names.items()}
            pictures = make_pictures(live.rig, feed, asks)
        made = Site(feed, store, lambda: body, asking(topic) if operates else None, pictures)
        view._stack.push(stack.pop_all())
    view.serve(_server(make_app(made, rules), address), listening)
    return view


def _server(app: object, address: Address) -> uvicorn.Server:
    return uvicorn.Server(
        uvicorn.Config(
            app,  # type: ignore[arg-type]
            log_level="error",
            access_log=False,
            server_header=False,
            proxy_headers=False,  # anybody could say to be somebody else, whose rate is not used up
            ws="websockets-sansio",
            ws_max_size=MAX_MESSAGE_BYTES,
            ws_ping_timeout=PING_S,
            limit_concurrency=MAX_CONNECTIONS,
            timeout_graceful_shutdown=1,
            ssl_certfile=None if address.certificate is None else str(address.certificate),
            ssl_keyfile=None if address.key is None else str(address.key),
        )
    )


def _listen(address: Address) -> socket.socket:
    """Return a socket that listens; raise `InputError` naming a port that is taken."""
    family = socket.AF_INET6 if address.host.startswith("[") else socket.AF_INET
    # Named TCP: asyncio lets only sockets that are send small parts at once, not 40 ms later.
    listening = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((address.host.strip("[]"), address.port))
        listening.listen(128)
    except OSError as error:
        listening.close()
        if error.errno == errno.EADDRINUSE:
            raise InputError(
                f"port {address.port} is in use: stop the program that has it (`ss -ltnp 'sport = "
                f":{address.port}'` names it), or choose another with --listen"
            ) from None
        raise InputError(
            "--listen", f"{address.host}:{address.port}", "an address of this machine"
        ) from None
    return listening
