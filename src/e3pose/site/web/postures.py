"""Postures, speed, zones and uncertain parts of people, in the page's words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from e3pose.events.body import carriage
from e3pose.events.states import STATES
from e3pose.events.watch import Watch, begin_watch, site_watch
from e3pose.model.person_event import PersonEvent, sentence
from e3pose.settings.events_table import EventsTable
from e3pose.settings.resolved import ResolvedSite
from e3pose.site.connect import LiveSlot
from e3pose.site.zones import Zones

NOBODY: Mapping[int, int] = {}
UNSURE_M = 0.06  # definition: a joint with a larger sigma is shown as uncertain
POSTURE = (
    "state", "probability", "speed_mps", "hips_m", "trunk_deg", "arms_raised", "since_ns"
)  # fmt: skip
PARTS = {
    "head": ("nose", "left_ear", "right_ear", "left_eye", "right_eye", "head"),
    **{
        f"{side} {part}": tuple(f"{side}_{joint}" for joint in joints)
        for side in ("left", "right")
        for part, joints in (("arm", ("elbow", "wrist")), ("leg", ("knee", "ankle")))
    },
}


def page_watch(site: ResolvedSite) -> Watch:
    """Return the watch over people for the page, without events if the site has none."""
    asked = site_watch(site)
    if asked is not None:
        return asked
    watch = begin_watch(EventsTable(), site.skeleton.joints, site.file.zone)
    return replace(watch, rules={}, memories={})


def doing(
    slot: LiveSlot, watch: Watch | None, zones: Zones, since_ns: Mapping[int, int] = NOBODY
) -> list[dict[str, Any]]:
    """Return the state of each person of a slot, in the slot's order.

    Args:
        slot: with its people.
        watch: after the slot, or one just before it; None where nobody follows people.
        zones: after the slot.
        since_ns: by track, since when somebody is there; the watch may know it better of one whose
            number changed, and later of one who was there before it began.
    """
    unsure, found = unsure_parts(slot), list[dict[str, Any]]()
    for row, track in enumerate(slot.people.track_ids.tolist()):
        does = posture(track, watch)
        known = [ns for ns in (does["since_ns"], since_ns.get(track)) if ns is not None]
        stays = [
            {"name": table.name, "since_ns": inside[track].since_ns}
            for table, inside in zip(zones.tables, zones.stays, strict=False)
            if track in inside
        ]
        does |= {"since_ns": min(known, default=None), "zones": stays}
        found.append({**does, "unsure": unsure[row]})
    return found


def unsure_parts(slot: LiveSlot) -> list[list[str]]:
    """Return the body parts of each person with an unknown or uncertain joint."""
    place = {name: index for index, name in enumerate(slot.joints)}
    sure = np.isfinite(slot.people.joints_m[..., 0]) & ~(slot.people.sigma_m > UNSURE_M)
    found: list[list[str]] = [[] for _ in range(len(slot))]
    for part, names in PARTS.items():
        rows = [place[name] for name in names if name in place]
        if not rows:
            continue
        # Of a head one joint is enough, of a limb all count.
        known = sure[:, rows].any(axis=1) if part == "head" else sure[:, rows].all(axis=1)
        for row in np.flatnonzero(~known).tolist():
            found[row].append(part)
    return found


def told(event: PersonEvent) -> dict[str, Any]:
    """Return an event of a person for the page, which formats its times."""
    names = ("kind", "phase", "track", "zone", "start_ns", "time_ns", "score", "says")
    return {**{name: getattr(event, name) for name in names}, "sentence": sentence(event)}


def posture(track: int, watch: Watch | None) -> dict[str, Any]:
    """Return posture, carriage and speed of a person, and since when; None if unknown."""
    person = None if watch is None else watch.shown.get(track)
    if watch is None or person is None:
        return dict.fromkeys(POSTURE)
    state = int(person.states.argmax())
    held = carriage(watch.joints, person.joints_m, person.surface_m)
    raised = _known(held.arms_raised, 0)
    return {
        "state": STATES[state],
        "probability": round(float(person.states[state]), 2),
        "speed_mps": _known(person.speed_mps, 2),
        "hips_m": _known(held.hips_m, 2),
        "trunk_deg": _known(held.trunk_deg, 0),
        "arms_raised": None if raised is None else int(raised),
        "since_ns": person.since_ns,
    }


def _known(value: float, digits: int) -> float | None:
    return round(value, digits) if np.isfinite(value) else None
