"""Admission: the edge joins its network, admits programs, and watches certificates expire."""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from e3pose.base.errors import InputError
from e3pose.base.version import Watched
from e3pose.edge.server import EdgeServer
from e3pose.settings.site_file import SiteTable
from e3pose.wire.access import Link, Roll
from e3pose.wire.keys.folder import link_of, not_admitted, read_roll
from e3pose.wire.keys.renewal import expiring, renewal_advice
from e3pose.wire.transport import Transport

LOOK_S = 60.0
AGAIN = datetime.timedelta(days=1)


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


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.timezone.utc)


@dataclass(slots=True, eq=False)
class ExpiryWatch:
    """Looks at the certificates in a folder now and then.

    Attributes:
        folder: of the site's keys; None where it has none.
        report: called with kind and message of an event.
        now: the system's time, UTC, by which certificates are judged.
        now_s: a steady clock.
    """

    folder: Path | None
    report: Callable[[str, str], object]
    now: Callable[[], datetime.datetime] = _now
    now_s: Callable[[], float] = time.monotonic
    _due_s: float = 0.0
    _reported: dict[tuple[str, bool], datetime.datetime] | None = None

    def update(self) -> None:
        """Report expiring certificates; cheap enough for every call of a loop."""
        if self.folder is None or self.now_s() < self._due_s:
            return
        self._due_s = self.now_s() + LOOK_S
        now, known = self.now(), self._reported or {}
        self._reported = {}
        try:
            found = list(expiring(self.folder, now))
        except InputError:  # being replaced, or said by who reads it
            self._reported = known
            return
        for name, until in found:
            key = name, until < now
            said = known.get(key)
            # A clock that was set back must not silence it.
            if said is None or not datetime.timedelta() <= now - said < AGAIN:
                self.report("certificate", _line(name, until, now))
                said = now
            self._reported[key] = said


def _line(name: str, until: datetime.datetime, now: datetime.datetime) -> str:
    advice = renewal_advice(name)
    if until < now:
        return (
            f"certificate of {name} expired on {until:%Y-%m-%d %H:%M} UTC: no new connection "
            f"is accepted with it; {advice}"
        )
    days = (until - now).days
    return f"certificate of {name} expires on {until:%Y-%m-%d}, in {days} days: {advice}"
