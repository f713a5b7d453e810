"""How an edge joins the network of its site, and which programs it admits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from e3pose.base.errors import InputError
from e3pose.base.version import Watched
from e3pose.edge.server import EdgeServer
from e3pose.settings.site_file import SiteTable
from e3pose.wire.access import Link, Roll
from e3pose.wire.keys.folder import link_of, not_admitted, read_roll
from e3pose.wire.transport import Transport


def edge_link(site: SiteTable) -> tuple[Link, Roll | None]:
    """Return the link of a site's edge, and the programs that may join.

    Raises:
        InputError: for an endpoint that is not safe, or certificates that cannot be used.
    """
    table = site.link
    roll = None
    if table.endpoint.encrypted and table.keys is not None:
        roll = read_roll(table.keys)
    try:
        link = link_of(
            "edge", site.name, table.endpoint, table.keys, table.upstream, insecure=table.insecure
        )
    except InputError as error:
        if error.thing != "endpoint":
            raise
        raise error.under("link").at(site.path) from None
    return link, roll


@dataclass(slots=True, eq=False)
class Admission:
    """Applies added and revoked certificates while the edge runs.

    Attributes:
        site: its file.
        server: of the edge.
        join: opens the network by the rules of a list.
        report: called with messages for operators.
    """

    site: SiteTable
    server: EdgeServer
    join: Callable[[Link, Roll | None], Transport]
    report: Callable[[str], Any]
    _keys: Watched = field(init=False)

    def __post_init__(self) -> None:
        folder, names = self.site.link.keys, ("keys.toml", "edge.pem", "edge.key")
        self._keys = Watched(
            () if folder is None else tuple(folder / name for name in names),
            self._rejoin,  # where it fails, the edge goes on by the rules it has
            lambda why: self.report(f"cannot reload the certificates: {why}"),
        )

    def update(self) -> None:
        """Rejoin if the list of certificates or the edge's own changed since the last call."""
        self._keys.update()

    def _rejoin(self) -> None:
        self.server.membership.rejoin(self.prepare())
        self.report("certificates reloaded")

    def prepare(self) -> Callable[[], Transport]:
        """Return a function that opens the network with the present list of certificates.

        Raises:
            InputError: for certificates that cannot be used.
        """
        link, roll = edge_link(self.site)
        inbox = self.server.inbox
        inbox.not_admitted = not_admitted(roll, inbox.rig.camera_ids)
        return lambda: self.join(link, roll)
