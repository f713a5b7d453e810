"""The file of a hub: its database, and the sites that it asks."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from e3pose.base.bounded import read_toml
from e3pose.base.errors import InputError
from e3pose.base.table import read_table
from e3pose.wire.access import Link, check_link, split_endpoint
from e3pose.wire.keys.folder import holder, valid_certificates
from e3pose.wire.topics import check_site

FORMAT, VERSION = "e3pose-hub", 1
MAX_BYTES = 2**22


class SiteOfHub(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`[[site]]`: a site that the hub asks.

    Attributes:
        name: of the site, as its own file says.
        endpoint: of its edge or a router before it, `tls/HOST:PORT`; `tcp/HOST:PORT` on loopback.
        keys: folder of a hub's certificate of that site, for tls.
        group: that it belongs to; people are given rights by group.
        page: address of its live page.
        page_tokens: file of that page's tokens, which the hub's page hands to whom has the right.
    """

    name: str
    endpoint: str
    keys: str = ""
    group: Annotated[str, Meta(max_length=100)] = ""
    page: Annotated[str, Meta(pattern=r"^(https?://[^\s#]{1,300})?$")] = ""
    page_tokens: str = ""


class ViewOfHub(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`[view]`: the page over sites.

    Attributes:
        listen: `HOST:PORT`; beyond this machine with a certificate.
        certificate, key: of https, PEM files beside the hub's file.
        hosts: names by which browsers reach it.
        proxies: addresses of reverse proxies, which say for whom they ask.
        insecure: whether plain http beyond this machine is allowed.
    """

    listen: str = "127.0.0.1:8480"
    certificate: str = ""
    key: str = ""
    hosts: tuple[str, ...] = ()
    proxies: tuple[str, ...] = ()
    insecure: bool = False


class HubTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The file of a hub.

    Attributes:
        format, version: `FORMAT` and `VERSION`.
        database: a file (SQLite), or `postgresql://USER@HOST/NAME`.
        every_s: seconds between two questions to a site.
        archives: folders, or addresses that fsspec knows.
        view: the page over sites.
        site: the sites.
    """

    format: str
    version: int
    database: str = "hub.db"
    every_s: Annotated[float, Meta(ge=1, le=86400)] = 60.0
    archives: tuple[str, ...] = ()
    view: ViewOfHub = ViewOfHub()
    site: tuple[SiteOfHub, ...] = ()


@dataclass(frozen=True, slots=True)
class Hub:
    """A hub as its file says, with places as they are from here.

    Attributes:
        path: the file.
        database: path or URL.
        every_s: seconds between two questions to a site.
        archives: folders or addresses.
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
        if split_endpoint(site.endpoint)[0] == "tls":
            try:
                certificates = valid_certificates(self.path.parent / (site.keys or name), "hub")
            except InputError as error:
                wanted = "a certificate that e3pose keys add --hub made at the site"
                raise InputError(f"{error}, expected {wanted}") from None
        link = Link("viewer", name, site.endpoint, certificates)
        check_link(link)
        return link


def host_and_port(listen: str) -> tuple[str, int]:
    """Return where the page listens; raise `InputError` for what is not HOST:PORT."""
    try:
        return split_endpoint(f"tcp/{listen}")[1:]
    except InputError:
        wanted = "HOST:PORT, such as 127.0.0.1:8480"
        raise InputError("view.listen", repr(listen[:100]), wanted) from None


def check_links(hub: Hub) -> None:
    """Raise `InputError` if no site can be asked; one that cannot keeps no other from it."""
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
    read = read_toml(path, MAX_BYTES)
    try:
        table = msgspec.convert(msgspec.to_builtins(read_table(HubTable, read)), HubTable)
        if (table.format, table.version) != (FORMAT, VERSION):
            found = f"{table.format[:40]} version {table.version}"
            raise InputError("format", found, f"{FORMAT} version {VERSION}")
        names = [check_site(site.name) for site in table.site]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"site {name}", "twice", "each site once")
        for site in table.site:
            split_endpoint(site.endpoint)
        if bool(table.view.certificate) != bool(table.view.key):
            raise InputError("view", "one of certificate and key", "both, for https")
        host_and_port(table.view.listen)
    except msgspec.ValidationError as error:
        raise InputError(f"{path}: {error}") from None
    except InputError as error:
        raise error.at(path) from None
    url = "://" in table.database
    database = table.database if url else str(path.parent / table.database)
    archives = tuple(a if "://" in a else str(path.parent / a) for a in table.archives)
    sites = {site.name: site for site in table.site}
    return Hub(path, database, table.every_s, archives, table.view, sites)
