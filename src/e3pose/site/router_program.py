"""A router in front of an edge, with the edge's access rules."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from e3pose.base.errors import InputError
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
    _seen: tuple[int, int] = (0, 0)
    _refused: str = ""

    def open(self) -> None:
        """Join; raise `InputError` for what cannot be used."""
        seen = self._version()
        link, roll = router_link(self.folder, self.endpoint, self.edge)
        self.close()  # the port is one
        self._transport = self.join(link, roll)
        self.site, self._seen = roll.site, seen

    def update(self) -> None:
        """Reconnect if the list changed; an error in it is logged once, and retried."""
        if self._transport is not None and self._version() == self._seen:
            return
        try:
            self.open()
        except InputError as error:
            if str(error) != self._refused:
                self.report(f"cannot reload the certificates: {error}")
            self._refused = str(error)
            return
        self._refused = ""
        self.report("certificates reloaded")

    def close(self) -> None:
        """Leave."""
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    def _version(self) -> tuple[int, int]:
        try:
            status = (self.folder / "keys.toml").stat()
        except OSError:
            return self._seen  # being replaced
        return status.st_mtime_ns, status.st_ino
