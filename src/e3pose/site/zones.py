"""Zones of the floor: enter, dwell and leave events from published poses.

Not rated for safety: people may be missed, seen late or where nobody is. Pure: the state is a
value that `advance` takes and returns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from e3pose.events.people import Seen
from e3pose.model.region import distance_m, in_polygon, middles_m
from e3pose.model.zone_event import Kind, ZoneEvent
from e3pose.settings.site_file import ZoneTable

MARGIN_M = 0.1  # who is nearer than this to a zone has not left it: nobody stands still exactly
LOST_S = 1.0  # a track that is not shown for longer has left


@dataclass(frozen=True, slots=True)
class Stay:
    """A person in a zone: start, last sight, and whether `dwell` was sent."""

    since_ns: int
    seen_ns: int
    dwelt: bool = False


@dataclass(frozen=True, slots=True)
class Zones:
    """People in each zone.

    Attributes:
        tables: the zones of a site.
        stays: of each zone, by track.
    """

    tables: tuple[ZoneTable, ...]
    stays: tuple[dict[int, Stay], ...] = field(default=())

    def counts(self) -> dict[str, int]:
        """Return how many people are in each zone, by its name."""
        stays = self.stays or ({},) * len(self.tables)
        return {table.name: len(inside) for table, inside in zip(self.tables, stays, strict=True)}


def advance(zones: Zones, slot: Seen) -> tuple[Zones, list[ZoneEvent]]:
    """Return the zones after a slot, and its events.

    Args:
        zones: who was where.
        slot: the newest; an older one than before changes nothing.
    """
    places_m = middles_m(slot.people.joints_m)
    stays, events = [], list[ZoneEvent]()
    before = zones.stays or ({},) * len(zones.tables)
    for table, inside in zip(zones.tables, before, strict=True):
        corners_m = np.array(table.corners, dtype=np.float64)
        within = in_polygon(places_m, corners_m)
        near = within | (distance_m(places_m, corners_m) <= MARGIN_M)
        now, happened = _advance_one(table, inside, slot, within.tolist(), near.tolist())
        stays.append(now)
        events += happened
    return Zones(zones.tables, tuple(stays)), events


def _advance_one(
    table: ZoneTable,
    inside: dict[int, Stay],
    slot: Seen,
    within: Sequence[bool],
    near: Sequence[bool],
) -> tuple[dict[int, Stay], list[ZoneEvent]]:
    now, events = dict(inside), list[ZoneEvent]()
    shown = dict(zip(slot.people.track_ids.tolist(), zip(within, near, strict=True), strict=True))

    def add(kind: Kind, track: int, since_ns: int) -> None:
        stayed_s = round((slot.time_ns - since_ns) / 1e9, 3)
        events.append(
            ZoneEvent(kind, table.name, track, len(now), stayed_s, slot.slot, slot.time_ns)
        )

    for track, stay in inside.items():
        lost = track not in shown and slot.time_ns - stay.seen_ns > LOST_S * 1e9
        if lost or (track in shown and not shown[track][1]):
            del now[track]
            add("leave", track, stay.since_ns)
    for track, (is_within, is_near) in shown.items():
        if track not in now and is_within:
            now[track] = Stay(slot.time_ns, slot.time_ns)
            add("enter", track, slot.time_ns)
        elif track in now and is_near:
            stay = now[track]
            due = slot.time_ns - stay.since_ns >= table.dwell_s * 1e9
            now[track] = Stay(stay.since_ns, slot.time_ns, stay.dwelt or due)
            if due and not stay.dwelt:
                add("dwell", track, stay.since_ns)
    return now, events
