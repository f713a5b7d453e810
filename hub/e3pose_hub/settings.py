"""The file of a hub: its database, and the sites that it asks."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

from e3pose.base.errors import InputError
from e3pose.base.table import check_bounds, convert, entry, read_file
from e3pose.wire.access import Link, check_link
from e3pose.wire.endpoint import Endpoint, read_endpoint, read_host_port
from e3pose.wire.keys.folder import holder, valid_certificates
from e3pose.wire.topics import check_site

MAX_BYTES = 2**22
PAGE = r"https?://[^\s#]{1,300}"
LISTEN = "127.0.0.1:8480"


def read_page(found: object) -> str:
    """Return the address of a live page; raise `InputError` for another text."""
    words: str = convert(str, found)
    if words and not re.fullmatch(PAGE, words):
        raise InputError("", repr(words[:80]), "an address such as https://edge.local:8470/")
    return words


def read_listen(found: object) -> Endpoint:
    """Return where the page listens; raise `InputError` for what is not HOST:PORT."""
    return read_host_port(found, example=LISTEN)


@dataclass(frozen=True, slots=True)
class SiteOfHub:
    """`[[site]]`: a site that the hub asks.

    Attributes:
        name: of the site, as its own file says.
        endpoint: of its edge or a router before it, `tls/HOST:PORT`; `tcp/HOST:PORT` on loopback.
        keys: folder of a hub's certificate of that site, for tls.
        group: that it belongs to; people are given rights by group.
        page: address of its live page.
        page_users: whether that page lets in users of the hub, as `hubs` in its site file says.
        page_tokens: no longer used; accepted for a release.
    """

    name: str
    endpoint: Endpoint = entry(read=read_endpoint, write='"tls/edge.local:7447"')
    keys: str = ""
    group: str = ""
    page: str = entry("", read=read_page)
    page_users: bool = False
    page_tokens: str = ""

    def __post_init__(self) -> None:
        try:
            check_site(self.name)
        except InputError as error:
            raise error.at(thing="name") from None
        if len(self.group) > 100:
            raise InputError("group", f"{len(self.group)} characters", "100 at most")


@dataclass(frozen=True, slots=True)
class ViewOfHub:
    """`[view]`: the page over sites.

    Attributes:
        listen: `HOST:PORT`; beyond this machine with a certificate.
        certificate, key: of https, PEM files beside the hub's file.
        hosts: names by which browsers reach it.
        proxies: addresses of reverse proxies, which say for whom they ask.
        insecure: whether plain http beyond this machine is allowed.
    """

    listen: Endpoint = entry(read_listen(LISTEN), read=read_listen)
    certificate: str = ""
    key: str = ""
    hosts: tuple[str, ...] = ()
    proxies: tuple[str, ...] = ()
    insecure: bool = False


@dataclass(frozen=True, slots=True)
class HubTable:
    """The file of a hub.

    Attributes:
        format, version: of the file.
        database: a file (SQLite), or `postgresql://USER@HOST/NAME`.
        every_s: seconds between two questions to a site.
        archives: no longer used; accepted for a release.
        view: the page over sites.
        site: the sites.
    """

    format: Literal["e3pose-hub"]
    version: Literal[1]
    database: str = "hub.db"
    every_s: Annotated[float, Meta(ge=1, le=86400)] = 60.0
    archives: tuple[str, ...] = ()
    view: ViewOfHub = ViewOfHub()
    site: tuple[SiteOfHub, ...] = ()

    def __post_init__(self) -> None:
        check_bounds(self)
        if bool(self.view.certificate) != bool(self.view.key):
            raise InputError("view", "one of certificate and key", "both, for https")
        names = [site.name for site in self.site]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"site {name}", "twice", "each site once")


@dataclass(frozen=True, slots=True)
class Hub:
    """A hub as its file says, with places as they are from here.

    Attributes:
        path: the file.
        database: path or URL.
        every_s: seconds between two questions to a site.
        archives: as the file has them; no longer used.
        view: the page over sites.
        sites: the sites by name.
    """

    path: Path
    database: str
    every_s: float
    archives: tuple[str, ...]
    view: ViewOfHub
    sites: dict[str, SiteOfHub]

    def of_groups(self, groups: Collection[str] | None) -> list[str]:
        """Return the sites of some groups, of all for None, in the order of the file.

        Raises:
            InputError: for a group that no site is of.
        """
        known = dict.fromkeys(site.group for site in self.sites.values())
        for group in groups or ():
            if group not in known:
                names = ", ".join(name for name in known if name) or "a group of a [[site]]"
                raise InputError("group", repr(group[:80]), f"one of {names[:300]}")
        return [n for n, site in self.sites.items() if groups is None or site.group in groups]

    def link(self, name: str) -> Link:
        """Return how a site is reached, as a hub of it.

        Raises:
            InputError: for certificates that cannot be used.
        """
        site, certificates = self.sites[name], None
        if site.endpoint.encrypted:
            try:
                certificates = valid_certificates(self.path.parent / (site.keys or name), "hub")
            except InputError as error:
                wanted = "a certificate that e3pose keys add --hub made at the site"
                raise InputError(f"{error}, expected {wanted}") from None
        link = Link("viewer", name, site.endpoint, certificates)
        check_link(link)
        return link


def check_links(hub: Hub) -> None:
    """Raise `InputError` if every site is unreachable."""
    problems = list[InputError]()
    for name in hub.sites:
        try:
            hub.link(name)
        except InputError as error:
            problems.append(error)
    if problems and len(problems) == len(hub.sites):
        raise problems[0]


def holder_at(link: Link) -> str:
    """Return the hub whose link it is; `hub` where a site has no certificates."""
    return "hub" if link.certificates is None else holder(link.certificates)


def load_hub(named: Path) -> Hub:
    """Read the file of a hub, or `hub.toml` in its folder.

    Raises:
        InputError: naming the file, what was found and what was expected.
    """
    path = named / "hub.toml" if named.is_dir() else named
    if not path.is_file():
        raise InputError(str(path), "no such file", "the file of a hub, or its folder")
    table = read_file(HubTable, path, MAX_BYTES)
    url = "://" in table.database
    database = table.database if url else str(path.parent / table.database)
    sites = {site.name: site for site in table.site}
    return Hub(path, database, table.every_s, table.archives, table.view, sites)
