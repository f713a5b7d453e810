"""Summaries of a site per minute, made of the rows of its store: all that may leave it.

No pose and nobody's identity is in a summary. Used by the writer's thread alone, off the slot's
path. The record is in `docs/reference/outbox.md`.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import sqrt
from typing import Any

import numpy as np

from e3pose.store.rows import NS, Presence, Row

VERSION = 1  # of the record: one more when a column changes its meaning
MINUTE_NS = 60 * NS
GRACE_NS = 5 * NS  # rows of a minute may come so late
LONGEST_STEP_S = 1.0  # between two looks at what people do; nobody knows what they did in a longer
CHARGE_DIGITS = 6  # what an hour drains is to be told to a percent, of a battery for a year
MOST_NAMES = 200  # of zones, states, kinds and cameras in one summary
# Events that begin a fault, and what ends it.
FAULTS = {
    "camera-lost": ("camera-back",),
    "camera-useless": ("camera-useful",),
    "camera-short": ("camera-enough",),
    "camera-moved": ("camera-in-place",),
    "record-trouble": ("record-recovered",),
    "stalled": ("rejoined",),
    "store-full": ("store-recovered",),
    "store-trouble": ("store-recovered",),
}
ENDS = {end: kind for kind, ends in FAULTS.items() for end in ends if end != "store-recovered"}


@dataclass(slots=True, eq=False)
class Tally:
    """Sums of the minute so far.

    Attributes:
        begin_ns: from when on.
        shown_ns: its newest slot.
        slots, views, people, most_people: sums over its slots; the most in one of them.
        took_s: computing them.
        variance_m2, joints: sum over all joints of the squared standard deviation along an axis.
        blind, events, entered: counts by cause, kind, and zone.
        zone_s, state_s: person-seconds by zone and state.
        joules: by camera, then by source.
        charge: of batteries, by camera.
        faults: that stood in it.
    """

    begin_ns: int
    shown_ns: int = 0
    slots: int = 0
    views: int = 0
    people: int = 0
    most_people: int = 0
    took_s: float = 0.0
    variance_m2: float = 0.0
    joints: int = 0
    blind: Counter[str] = field(default_factory=Counter)
    events: Counter[str] = field(default_factory=Counter)
    entered: Counter[str] = field(default_factory=Counter)
    zone_s: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    state_s: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    joules: dict[str, dict[str, float]] = field(default_factory=dict)
    charge: dict[str, float] = field(default_factory=dict)
    faults: set[str] = field(default_factory=set)


class Minutes:
    """Sums up minutes: `take` rows, then `closed` returns the finished minutes."""

    def __init__(
        self, software: str, cameras: Sequence[str], now_ns: int, titles: Mapping[str, str]
    ) -> None:
        """Begin, mostly in the middle of a minute.

        Args:
            software: what writes, with its version.
            cameras: of the rig, which are lost until an event says that they are back.
            now_ns: the time; rows of an earlier one are what a killed program left.
            titles: what people call cameras, by id; the id where one is not there.
        """
        self._software, self._titles = software, titles
        self.begun_ns = now_ns
        self._open: dict[int, Tally] = {}  # by the beginning of the minute on the clock
        self._closed_ns = now_ns - now_ns % MINUTE_NS  # minutes before it are over
        self._shown_ns = 0  # of the newest slot: people are known to be in zones until then
        self._inside: dict[str, tuple[int, int]] = {}  # people in a zone, and counted until when
        self._present: Presence | None = None
        self._faults = {f"camera-lost {titles.get(camera, camera)}" for camera in cameras}

    def take(self, rows: Iterable[Row]) -> None:
        """Add rows as they go to the store, in the order in which they came."""
        people = Counter[tuple[int, int]]()
        spread: dict[int, list[bytes]] = {}
        for table, row in rows:
            if table == "slots":
                self._add_slot(row)
            elif table == "poses":
                people[self._minute(row["time_ns"]), row["slot"]] += 1
                if row["sigma_m"] is not None:
                    spread.setdefault(self._minute(row["time_ns"]), []).append(row["sigma_m"])
            elif table == "energy":
                self._add_energy(row)
            elif table == "events":
                self._add_event(row)
            elif table == "zones":
                self._add_zone(row)
        for (minute, _), count in people.items():
            tally = self._tally(minute)
            tally.people += count
            tally.most_people = max(tally.most_people, count)
        for minute, blobs in spread.items():
            squares = np.square(np.frombuffer(b"".join(blobs), dtype="<f2").astype(np.float64))
            tally = self._tally(minute)
            tally.variance_m2 += float(np.nansum(squares))
            tally.joints += int(np.isfinite(squares).sum())

    def present(self, now: Presence) -> None:
        """Add the states of people since the last call."""
        before, self._present = self._present, now
        if before is None or not 0 < now.time_ns - before.time_ns <= LONGEST_STEP_S * NS:
            return
        tally, passed_s = self._tally(now.time_ns), (now.time_ns - before.time_ns) / NS
        for state, persons in now.states.items():
            tally.state_s[state] += persons * passed_s

    def closed(self, now_ns: int, ending: bool = False) -> list[Row]:
        """Return summaries of the minutes that are over, oldest first.

        Args:
            now_ns: the time.
            ending: whether nothing more comes: the present minute is then over, too.
        """
        self._tally(now_ns)  # a minute without any row is one, too
        over = [m for m in self._open if ending or m + MINUTE_NS + GRACE_NS <= now_ns]
        rows = list[Row]()
        for minute in sorted(over):
            end_ns = min(minute + MINUTE_NS, max(now_ns, self._shown_ns))
            for zone in self._inside:
                self._count_inside(zone, min(end_ns, self._shown_ns))
            tally = self._open.pop(minute)
            if minute + MINUTE_NS <= self.begun_ns:  # of a program that was killed in it
                end_ns = tally.shown_ns
            tally.faults |= self._faults
            self._closed_ns = max(self._closed_ns, minute + MINUTE_NS)
            if end_ns > tally.begin_ns:
                rows.append(("summaries", summary(tally, end_ns, self._software)))
        return rows

    def _minute(self, time_ns: int) -> int:
        return time_ns - time_ns % MINUTE_NS

    def _tally(self, time_ns: int) -> Tally:
        minute = self._minute(time_ns)
        found = self._open.get(minute)
        if found is None:
            # One that was closed, or that this program saw a part of, begins with what comes now.
            whole = minute >= self._closed_ns and minute >= self.begun_ns
            found = self._open[minute] = Tally(minute if whole else time_ns)
        return found

    def _add_slot(self, row: Mapping[str, Any]) -> None:
        tally = self._tally(row["time_ns"])
        tally.slots += 1
        tally.views += row["arrived"].count("1")
        tally.took_s += row["took_s"]
        tally.shown_ns = max(tally.shown_ns, row["time_ns"])
        self._shown_ns = max(self._shown_ns, row["time_ns"])
        if row["blind"]:
            tally.blind[row["blind"]] += 1

    def _add_energy(self, row: Mapping[str, Any]) -> None:
        tally, camera = self._tally(row["time_ns"]), row["camera_id"]
        spent = tally.joules.setdefault(camera, defaultdict(float))
        spent[row["source"].partition(":")[0]] += row["energy_j"]
        if row["charge"] is not None:
            tally.charge[camera] = row["charge"]

    def _add_event(self, row: Mapping[str, Any]) -> None:
        tally, kind, camera = self._tally(row["time_ns"]), row["kind"], row["camera_id"]
        camera = self._titles.get(camera, camera)
        tally.events[f"{kind} {row['phase']}" if row["phase"] else kind] += 1
        if kind in FAULTS:
            fault = f"{kind} {camera}" if camera else kind
            self._faults.add(fault)
            tally.faults.add(fault)
        elif kind == "store-recovered":
            self._faults -= {"store-full", "store-trouble"}
        elif kind in ENDS:
            self._faults.discard(f"{ENDS[kind]} {camera}" if camera else ENDS[kind])

    def _add_zone(self, row: Mapping[str, Any]) -> None:
        zone, time_ns = row["zone"], row["time_ns"]
        if row["kind"] == "enter":
            self._tally(time_ns).entered[zone] += 1
        self._count_inside(zone, time_ns)
        self._inside[zone] = row["count"], time_ns

    def _count_inside(self, zone: str, until_ns: int) -> None:
        """Add person-seconds in a zone, each to its minute."""
        count, since_ns = self._inside.get(zone, (0, until_ns))
        if until_ns <= since_ns:
            return
        self._inside[zone] = count, until_ns
        while count and since_ns < until_ns:
            end_ns = min(self._minute(since_ns) + MINUTE_NS, until_ns)
            self._tally(since_ns).zone_s[zone] += count * (end_ns - since_ns) / NS
            since_ns = end_ns


def summary(tally: Tally, end_ns: int, software: str) -> dict[str, Any]:
    """Return a minute as a row of `summaries`; its number is given where it is stored."""
    slots, joints = max(tally.slots, 1), max(tally.joints, 1)
    return {
        "time_ns": tally.begin_ns,
        "number": 0,
        "version": VERSION,
        "span_s": round((end_ns - tally.begin_ns) / NS, 3),
        "software": software,
        "slots": tally.slots,
        "views": round(tally.views / slots, 3) if tally.slots else None,
        "people": round(tally.people / slots, 3) if tally.slots else None,
        "most_people": tally.most_people,
        "error_mm": round(1e3 * sqrt(tally.variance_m2 / joints), 1) if tally.joints else None,
        "took_ms": round(1e3 * tally.took_s / slots, 3) if tally.slots else None,
        "blind": _json(tally.blind),
        "zones": _json(_minutes(tally.zone_s)),
        "entered": _json(tally.entered),
        "states": _json(_minutes(tally.state_s)),
        "events": _json(tally.events),
        "joules": _json({camera: _rounded(spent) for camera, spent in tally.joules.items()}),
        "charge": _json(_rounded(tally.charge, CHARGE_DIGITS)),
        "faults": json.dumps(sorted(tally.faults)[:MOST_NAMES], separators=(",", ":")),
    }


def _minutes(person_s: Mapping[str, float]) -> dict[str, float]:
    return {name: round(s / 60, 4) for name, s in person_s.items() if s > 0}


def _rounded(found: Mapping[str, float], digits: int = 3) -> dict[str, float]:
    return {name: round(value, digits) for name, value in found.items()}


def _json(found: Mapping[str, Any]) -> str:
    return json.dumps(dict(sorted(found.items())[:MOST_NAMES]), separators=(",", ":"))
