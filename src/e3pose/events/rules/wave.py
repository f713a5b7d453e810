"""Somebody waved: a hand above the shoulder goes to and fro."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from e3pose.events.body import Joints
from e3pose.events.intervals import Interval
from e3pose.events.people import Person
from e3pose.events.rules.base import Snapshot
from e3pose.events.states import SITTING, STANDING, WALKING
from e3pose.model.person_event import PersonEvent

WAVE_S = 2.0  # window in which it goes to and fro
TURNS = 4  # so often
LEAST_M = 0.12  # and so far each time
SURE = 0.8  # probability of standing, walking or sitting
QUIET_S = 10.0  # between two waves of one person
Way = tuple[tuple[int, float], ...]  # time_ns and metres to the side


@dataclass(frozen=True, slots=True)
class Memory:
    """Way of each raised hand, by track and side, and when each person waved last."""

    ways: Mapping[tuple[int, int], Way]
    last_ns: Mapping[int, int]


class Waved:
    """`waved`: once."""

    def __init__(self, joints: Joints) -> None:
        self._joints = joints

    def begin(self) -> Memory:
        """See `Rule.begin`."""
        return Memory({}, {})

    def advance(self, memory: Memory, snapshot: Snapshot) -> tuple[Memory, list[PersonEvent]]:
        """See `Rule.advance`."""
        ways: dict[tuple[int, int], Way] = {}
        last = {t: at for t, at in memory.last_ns.items() if snapshot.time_ns - at < QUIET_S * 1e9}
        events = []
        for track, person in snapshot.shown.items():
            if person.states[[STANDING, WALKING, SITTING]].sum() < SURE or person.on_floor > 0.5:
                continue
            for side in (0, 1):
                aside_m = self._aside_m(person, side)
                if np.isnan(aside_m):
                    continue
                since = snapshot.time_ns - int(WAVE_S * 1e9)
                before = memory.ways.get((track, side), ())
                way = (*(w for w in before if w[0] >= since), (snapshot.time_ns, aside_m))
                ways[track, side] = way
                if track not in last and turns_of(way) >= TURNS:
                    last[track] = snapshot.time_ns
                    interval = Interval(way[0][0], snapshot.time_ns, 1.0)
                    events.append(snapshot.event("waved", "ended", track, interval, "waved"))
        return Memory(ways, last), events

    def _aside_m(self, person: Person, side: int) -> float:
        """Return how far a raised hand is to the side of its shoulder; NaN of one not raised."""
        wrist, shoulder = self._joints.wrists[side], self._joints.shoulders[side]
        other = self._joints.shoulders[1 - side]
        if min(wrist, shoulder, other) < 0:
            return np.nan
        at = person.joints_m
        if not at[wrist, 2] > at[shoulder, 2]:
            return np.nan
        across = at[shoulder, :2] - at[other, :2]
        length = float(np.linalg.norm(across))
        if not length > 0.1:
            return np.nan
        return float((at[wrist, :2] - at[shoulder, :2]) @ across / length)


def turns_of(way: Way) -> int:
    """Return how often a way turns back by at least `LEAST_M`."""
    if not way:
        return 0
    turns, low, high, heads = 0, way[0][1], way[0][1], 0
    for _, aside_m in way:
        low, high = min(low, aside_m), max(high, aside_m)
        if heads <= 0 and aside_m - low >= LEAST_M:
            turns, heads, high = turns + (heads < 0), 1, aside_m
        elif heads >= 0 and high - aside_m >= LEAST_M:
            turns, heads, low = turns + (heads > 0), -1, aside_m
    return turns
