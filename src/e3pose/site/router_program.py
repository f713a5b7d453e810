"""A router in front of an edge, with the edge's access rules."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.version import Watched
from e3pose.wire.access import Link, Roll
from e3pose.wire.endpoint import Endpoint
from e3pose.wire.keys.folder import link_of, read_roll
from e3pose.wire.transport import Transport


def router_link(folder: Path, endpoint: Endpoint, edge: Endpoint) -> tuple[Link, Roll]:
    """Return the link of a router, and the programs that may join.

    Args:
        folder: that `e3pose keys add NAME --router` made.
        endpoint: where it listens.
        edge: where the edge listens.

    Raises:
        InputError: for an endpoint or a certificate that cannot be used.
    """
    for place in (endpoint, edge):
        if not place.encrypted:
            raise InputError(f"endpoint {place}: found no tls, expected tls/HOST:PORT")
    roll = read_roll(folder)
    return link_of("router", roll.site, endpoint, folder, (edge,)), roll


@dataclass(slots=True, eq=False)
class Router:
    """Joins the site, and rejoins when the list of certificates changes.

    Attributes:
        folder: see `router_link`.
        endpoint: likewise.
        edge: likewise.
        join: opens the network by the rules of a list.
        report: called with messages for operators.
        site: that it routes for, once it joined.
    """

    folder: Path
    endpoint: Endpoint
    edge: Endpoint
    join: Callable[[Link, Roll], Transport]
    report: Callable[[str], None]
    site: str = ""
    _transport: Transport | None = None
    _list: Watched = field(init=False)

    def __post_init__(self) -> None:
        self._list = Watched(
            (self.folder / "keys.toml",),
            self._reopen,
            lambda why: self.report(f"cannot reload the certificates: {why}"),
        )

    def open(self) -> None:
        """Join the network; raise `InputError` for unusable endpoints or certificates."""
        link, roll = router_link(self.folder, self.endpoint, self.edge)
        self.close()  # the port is one
        self._transport = self.join(link, roll)
        self.site = roll.site

    def update(self) -> None:
        """Reconnect if the list changed; an error in it is logged once, and retried."""
        self._list.update()

    def close(self) -> None:
        """Leave."""
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    def _reopen(self) -> None:
        self.open()
        self.report("certificates reloaded")
