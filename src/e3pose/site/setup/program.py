"""The program `e3pose setup`: a page on loopback that sets a site up, until it is closed."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.settings.site_file import SITE_FILE
from e3pose.site.setup.api import Table, setup_app
from e3pose.site.setup.session import SetupSession
from e3pose.site.web.access import Rules
from e3pose.site.web.address import listening_at
from e3pose.site.web.server import PageServer, serve
from e3pose.site.web.tokens import Tokens, make_tokens
from e3pose.wire.endpoint import read_host_port

LISTEN = "127.0.0.1:8471"


@dataclass(slots=True, eq=False)
class SetupServer(PageServer):
    """A set-up at work; its end is that of the site too, if the page started it.

    Its address has the token that only who started it knows.

    Attributes:
        table: what it works with.
        rules: who may come in.
        address: `HOST:PORT` where it listens.
    """

    table: Table
    rules: Rules[Tokens]
    address: str


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
    if not at.here_alone:
        raise InputError("--listen", at.place, "an address of loopback: set-up is for this machine")
    setup = desk_of(site)
    listening = listening_at(
        at.host, at.port, "such as another `e3pose setup`, or choose another with --listen"
    )
    address = f"{at.host}:{listening.getsockname()[1]}"
    # Every question needs the token: the page lists files and shows what cameras see.
    rules = Rules(
        make_tokens(), frozenset({"localhost", at.host.lower()}), open_reading=False,
        printed_by="e3pose setup",
    )  # fmt: skip
    table, ends = Table(setup), ExitStack()
    ends.callback(table.close)
    serving = serve(setup_app(table), rules, listening)
    ends.callback(serving.close)
    url = f"http://{address}/#token={rules.tokens.write}"
    return SetupServer(url, serving, ends, (), table, rules, address)


def desk_of(site: Path | None) -> SetupSession:
    """Return the setup of a site's folder, or one on which none was chosen yet."""
    if site is None:
        return SetupSession(Path.cwd())
    path = site.parent if site.name == SITE_FILE and site.is_file() else site
    path = path.resolve()
    if path.is_file():
        raise InputError(f"{site}: found a file, expected the folder of a site")
    setup = SetupSession(path.parent)
    with suppress(FileNotFoundError):
        if not path.exists() or not any(path.iterdir()):
            setup.choose(path.name, new=True)
            return setup
    setup.choose(path.name)
    return setup
