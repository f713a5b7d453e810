"""The program `e3pose setup`: a page on loopback that sets a site up, until it is closed."""

from __future__ import annotations

import errno
from contextlib import suppress
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.listener import Bounds, open_socket
from e3pose.settings.site_file import SITE_FILE
from e3pose.site.serving import CONNECTIONS, PER_ADDRESS, Serving
from e3pose.site.setup.api import Table, setup_app
from e3pose.site.setup.desk import Desk
from e3pose.site.web.access import Door, Rules
from e3pose.site.web.tokens import Tokens, make_tokens
from e3pose.wire.endpoint import read_host_port

LISTEN = "127.0.0.1:8471"


class SetupServer:
    """A set-up at work, until it is closed. Use it as a context manager.

    Attributes:
        url: of its page, with the token that only who started it knows.
        table: what it works with.
        rules: who may come in.
    """

    def __init__(self, table: Table, rules: Rules[Tokens], address: str, serving: Serving) -> None:
        """Describe a server; `open_setup` starts one."""
        self.table, self.rules, self.address, self._serving = table, rules, address, serving
        self.url = f"http://{address}/#token={rules.tokens.write}"

    def __enter__(self) -> SetupServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def running(self) -> bool:
        """Return whether it serves."""
        return self._serving.running()

    def close(self) -> None:
        """End the page, its work, and the site if the page started it."""
        self._serving.close()
        self.table.close()


def open_setup(site: Path | None = None, listen: str | None = None) -> SetupServer:
    """Serve the page of the set-up over HTTP on loopback.

    Args:
        site: folder of the site, there or to be made; None to choose on the page, among those in
            the current folder.
        listen: `HOST:PORT` of loopback.

    Raises:
        InputError: for an address beyond this machine, a port that is taken, or a folder that
            cannot be a site's.
    """
    at = read_host_port(listen or LISTEN, "--listen", LISTEN)
    host, port, words = at.host, at.port, at.place
    if not at.here_alone:
        raise InputError("--listen", words, "an address of loopback: set-up is for this machine")
    desk = desk_of(site)
    try:
        listening = open_socket(host, port)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise InputError(
                f"port {port} is in use, by another `e3pose setup`? Stop it, or choose another "
                "port with --listen"
            ) from None
        raise InputError("--listen", words, "an address of this machine") from None
    address = f"{host}:{listening.getsockname()[1]}"
    # Every question needs the token: the page lists files and shows what cameras see.
    rules = Rules(
        make_tokens(), frozenset({"localhost", host.lower()}), open_reading=False,
        printed_by="e3pose setup",
    )  # fmt: skip
    table = Table(desk)
    serving = Serving(
        Door(setup_app(table), rules), listening, Bounds(CONNECTIONS, PER_ADDRESS), None
    )
    return SetupServer(table, rules, address, serving)


def desk_of(site: Path | None) -> Desk:
    """Return the desk of a site's folder, or one on which none was chosen yet."""
    if site is None:
        return Desk(Path.cwd())
    path = site.parent if site.name == SITE_FILE and site.is_file() else site
    path = path.resolve()
    if path.is_file():
        raise InputError(f"{site}: found a file, expected the folder of a site")
    desk = Desk(path.parent)
    with suppress(FileNotFoundError):
        if not path.exists() or not any(path.iterdir()):
            desk.choose(path.name, new=True)
            return desk
    desk.choose(path.name)
    return desk
