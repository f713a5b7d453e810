"""The state of each site on the hub's page: its newest minute and the last 24 hours."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import msgspec
from sqlalchemy import Connection, Engine, Row, select

from e3pose.store.forgetting import DAY_NS
from e3pose.store.rows import NS
from e3pose.store.summaries import MINUTE_NS
from e3pose_hub.database import hours, sites, summaries
from e3pose_hub.settings import Hub

FRESH_NS = 5 * NS  # so long all who ask see the same: a minute of a site is not newer
NEW_NS = 10 * MINUTE_NS  # a site whose newest minute is older is silent
BEFORE_NS = 60 * MINUTE_NS  # between two charges that hours left are told by
BLIND = 0.1  # share of the newest minute's slots from which on it is trouble
DRAINS = 0.002  # of a battery in an hour; one that drains less has no hours that are left
COLUMNS = ("site", "time_ns", "span_s", "software", "slots", "people", "error_mm", "blind",
           "joules", "charge", "faults")  # fmt: skip


@dataclass(frozen=True, slots=True)
class SiteNow:
    """The state of a site.

    Attributes:
        site, group: its names.
        state: `well`, in `trouble` (faults, blind slots), or `silent`: nothing new came.
        problem: why the hub cannot ask it; empty if it can.
        heard_ns: when it answered last; None if never.
        newest_ns: when its newest minute began; None without any. Figures below are of it.
        people: mean people.
        error_mm: that the estimator states; None where nobody is.
        watts, measured: drawn, and the share of it that is measured; None where unknown.
        hours_left: of the battery that is empty first, as the last hour went; None if none drains.
        charge: of the battery with the lowest, [0, 1]; None without batteries.
        blind: share of its slots; of the last 24 hours where nothing is new.
        faults: that stand.
        software: its version.
        events: of the last 24 hours, by kind.
        most_people: in one slot of them.
        page: whether the hub knows its live page.
    """

    site: str
    group: str
    state: Literal["well", "trouble", "silent"]
    problem: str
    heard_ns: int | None
    newest_ns: int | None = None
    people: float | None = None
    error_mm: float | None = None
    watts: float | None = None
    measured: float | None = None
    hours_left: float | None = None
    charge: float | None = None
    blind: float | None = None
    faults: Sequence[str] = ()
    software: str = ""
    events: dict[str, int] | None = None
    most_people: int = 0
    page: bool = False


class Overviews:
    """The states of all sites, kept for some seconds for all who ask."""

    def __init__(self, engine: Engine, hub: Hub) -> None:
        """Ask nothing yet.

        Args:
            engine: of the hub's database.
            hub: its file.
        """
        self._engine, self._hub = engine, hub
        self._lock = threading.Lock()
        self._at_ns, self._found = 0, dict[str, SiteNow]()
        self._coded = dict[tuple[str, ...], msgspec.Raw]()

    def of(self, names: Sequence[str], now_ns: int) -> tuple[int, msgspec.Raw]:
        """Return the time of the states, and those of some sites as JSON.

        Where they are too old, one thread renews them; others get the old ones, if any.

        Args:
            names: of the sites.
            now_ns: the time.
        """
        if self._old(now_ns) and self._lock.acquire(blocking=not self._at_ns):
            try:
                if self._old(now_ns):
                    with self._engine.connect() as connection:
                        found = overview(connection, self._hub, [*self._hub.sites], now_ns)
                    self._found, self._coded = {one.site: one for one in found}, {}
                    self._at_ns = now_ns
            finally:
                self._lock.release()
        coded, key = self._coded, tuple(names)
        if key not in coded:
            coded[key] = msgspec.Raw(msgspec.json.encode([self._found[name] for name in names]))
        return self._at_ns, coded[key]

    def _old(self, now_ns: int) -> bool:
        return not 0 <= now_ns - self._at_ns < FRESH_NS


def overview(connection: Connection, hub: Hub, names: Sequence[str], now_ns: int) -> list[SiteNow]:
    """Return the states of some sites, in the order of their names.

    Args:
        connection: to the hub's database.
        hub: its file.
        names: of the sites.
        now_ns: the time.
    """
    newest = _newest(connection, now_ns - NEW_NS, now_ns + MINUTE_NS)
    earlier = _newest(connection, now_ns - BEFORE_NS - NEW_NS, now_ns - BEFORE_NS)
    days = dict[str, list[Any]]()
    recent = select(hours).where(hours.c.time_ns > now_ns - DAY_NS)
    for row in connection.execute(recent):
        days.setdefault(row.site, []).append(row)
    heard = {row.site: row for row in connection.execute(select(sites))}
    return [
        _site(hub, name, heard.get(name), newest.get(name), earlier.get(name), days.get(name, []))
        for name in names
    ]


def _newest(connection: Connection, start_ns: int, end_ns: int) -> dict[str, Row[Any]]:
    """Return the newest summary of each site that has one in a time."""
    c = summaries.c
    asked = select(*(c[name] for name in COLUMNS)).where(c.time_ns.between(start_ns, end_ns))
    return {row.site: row for row in connection.execute(asked.order_by(c.time_ns))}


def _site(
    hub: Hub,
    name: str,
    heard: Row[Any] | None,
    newest: Row[Any] | None,
    earlier: Row[Any] | None,
    day: Sequence[Row[Any]],
) -> SiteNow:
    one = hub.sites[name]
    events, slots = Counter[str](), sum(row.slots for row in day)
    for row in day:
        events.update(msgspec.json.decode(row.events))
    about: dict[str, Any] = {
        "site": name, "group": one.group, "page": bool(one.page),
        "problem": "never asked" if heard is None else heard.problem,
        "heard_ns": None if heard is None else heard.heard_ns,
        "events": dict(events.most_common()),
        "most_people": max((row.most_people for row in day), default=0),
    }  # fmt: skip
    if newest is None:
        blind = sum(row.blind for row in day) / slots if slots else None
        return SiteNow(state="silent", blind=blind, **about)
    spent = [source for of in msgspec.json.decode(newest.joules).values() for source in of.items()]
    joules = sum(value for _, value in spent)
    measured = sum(value for source, value in spent if source == "measured")
    blind = sum(msgspec.json.decode(newest.blind).values()) / newest.slots if newest.slots else None
    faults, charge = msgspec.json.decode(newest.faults), msgspec.json.decode(newest.charge)
    trouble = faults or not newest.slots or (blind or 0) > BLIND
    return SiteNow(
        state="trouble" if trouble else "well",
        newest_ns=newest.time_ns,
        people=newest.people,
        error_mm=newest.error_mm,
        watts=joules / newest.span_s if spent and newest.span_s else None,
        measured=measured / joules if joules else None,
        hours_left=_hours_left(newest, earlier),
        charge=min(charge.values(), default=None),
        blind=blind,
        faults=faults,
        software=newest.software,
        **about,
    )


def _hours_left(newest: Row[Any], earlier: Row[Any] | None) -> float | None:
    """Return until the first battery is empty, as the last hour went."""
    if earlier is None:
        return None
    passed_h = (newest.time_ns - earlier.time_ns) / NS / 3600
    then, left = msgspec.json.decode(earlier.charge), list[float]()
    for camera, charge in msgspec.json.decode(newest.charge).items():
        drained = (then.get(camera, charge) - charge) / passed_h
        if drained > DRAINS:
            left.append(charge / drained)
    return min(left, default=None)
