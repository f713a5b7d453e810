"""A fall: the hips go down fast, and then the person lies on the floor without getting up.

Who goes down on purpose kneels or crouches: the shanks tilt. Where they stay upright, as in a slide
along a wall, a slower descent is a fall, too, and so is one that ends half sitting.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from e3pose.events.intervals import Bounds, Interval, turn
from e3pose.events.people import Person
from e3pose.events.rules.base import Snapshot
from e3pose.events.states import STANDING, WALKING
from e3pose.model.person_event import PersonEvent
from e3pose.settings.events_table import EventsTable

DOWN_S = 2.0  # who was down for less has not got up: it was no lying
UP_S = 0.6
SURE = 0.8  # probability that somebody stands or walks


class OnFloor:
    """`on-floor`: begun after `lies_s`, ended when the person is up."""

    def __init__(self, table: EventsTable) -> None:
        self._bounds = Bounds(on=0.6, off=0.35, after_s=table.lies_s, ends_s=1.5)

    def begin(self) -> Mapping[int, Interval]:
        """See `Rule.begin`."""
        return {}

    def advance(
        self, memory: Mapping[int, Interval], snapshot: Snapshot
    ) -> tuple[Mapping[int, Interval], list[PersonEvent]]:
        """See `Rule.advance`."""
        turned = turn(memory, snapshot.on_floor(memory), snapshot.time_ns, self._bounds)
        events = [
            snapshot.event("on-floor", "begun", track, interval, "is on the floor", interval.most)
            for track, interval in turned.begun.items()
        ] + [
            snapshot.event("on-floor", "ended", track, interval, "was on the floor", interval.most)
            for track, interval in turned.ended.items()
        ]
        return turned.intervals, events


class GotUp:
    """`got-up`: somebody who was on the floor stands or walks."""

    def __init__(self, table: EventsTable) -> None:
        self._down = Bounds(on=0.6, off=0.35, after_s=DOWN_S, ends_s=8.0)

    def begin(self) -> Mapping[int, Interval]:
        """See `Rule.begin`."""
        return {}

    def advance(
        self, memory: Mapping[int, Interval], snapshot: Snapshot
    ) -> tuple[Mapping[int, Interval], list[PersonEvent]]:
        """See `Rule.advance`."""
        values = {track: person.on_floor for track, person in snapshot.shown.items()}
        intervals = dict(turn(memory, values, snapshot.time_ns, self._down).intervals)
        events = []
        for track, person in snapshot.shown.items():
            interval, states = intervals.get(track), person.states
            up = float(states[STANDING] + states[WALKING])
            if interval is None or not interval.told or up < SURE:
                continue
            if snapshot.time_ns - interval.held_ns > UP_S * 1e9:
                events.append(snapshot.event("got-up", "ended", track, interval, "got up", up))
                del intervals[track]
        return intervals, events


# Chosen on simulated homes, seeds 0 to 15; see docs/research/events.md.
LEAST_DROP = 0.16  # of the hips, share of the stature: from a seat to the floor are 0.24
FAST = 0.40  # mean speed of the middle half of the way, statures / s, by the root of the drop
FAST_SPREAD = 0.04
LYING = 0.6  # least probability: who sits on the floor upright has sat down
UPRIGHT_DEG = 35.0  # shanks on the way down: slides 14 to 21, kneeling first 57 to 81
SLID, SLUMPED = 0.25, 0.15  # in place of FAST and LYING where they stay upright
DROPPED = 0.7  # pace above which nobody slides: children drop to the floor at 0.95 and more
WINDOW_S = 4.0
LOW_S = 0.35  # how low somebody is, is a median of so long: at 12.5 slots a second of five
UNSEEN_S = 0.3  # a gap counts as so long


@dataclass(frozen=True, slots=True)
class Descent:
    """A descent of the hips.

    Attributes:
        drop: share of the stature.
        speed: statures per second in between.
        shanks_deg: median inclination of the shanks in the lower half; NaN where unknown.
    """

    drop: float
    speed: float
    shanks_deg: float = np.nan

    @property
    def pace(self) -> float:
        """Speed for a drop of one: what falls goes as fast as the root of its height."""
        return self.speed / float(np.sqrt(max(self.drop, 1e-3)))

    @property
    def least(self) -> tuple[float, float]:
        """Pace, and probability of lying after it, from which it is a fall."""
        slides = self.shanks_deg < UPRIGHT_DEG and self.pace < DROPPED
        return (SLID, SLUMPED) if slides else (FAST, LYING)

    def of_fall(self) -> tuple[bool, float]:
        """Return how much it is one of a fall: far enough, then fast; noise is fast, too."""
        return self.drop >= LEAST_DROP, self.pace


def descent_of(person: Person) -> Descent:
    """Return the last descent of a person's hips, by their trail."""
    if len(person.trail) < 2:
        return Descent(0.0, 0.0)
    times, heights, shanks_deg = np.array(person.trail).T
    times = times / 1e9
    recent = times >= times[-1] - WINDOW_S
    times, heights, shanks_deg = times[recent], heights[recent], shanks_deg[recent]
    low = float(np.median(heights[times >= times[-1] - LOW_S]))
    top = float(np.max(heights))
    drop = top - low
    if drop <= 0:
        return Descent(0.0, 0.0)
    # The middle half of the way: from a quarter below the top to a quarter above the floor.
    high = np.flatnonzero(heights >= top - 0.25 * drop)[-1]
    after = np.flatnonzero(heights[high:] <= low + 0.25 * drop)
    if not len(after):
        return Descent(drop, 0.0)
    end = high + after[0]
    lower = shanks_deg[high : end + 1][heights[high : end + 1] < low + 0.5 * drop]
    lower = lower[np.isfinite(lower)]
    upright_deg = float(np.median(lower)) if len(lower) else np.nan
    # What nobody saw may have gone as fast as a fall.
    took_s = max(float(np.minimum(np.diff(times[high : end + 1]), UNSEEN_S).sum()), 1e-3)
    return Descent(drop, float(heights[high] - heights[end]) / took_s, upright_deg)


@dataclass(frozen=True, slots=True)
class Memory:
    """People on the floor, and how fast each came there, with the time since when."""

    intervals: Mapping[int, Interval]
    descents: Mapping[int, Descent]


class Fall:
    """See the module."""

    def __init__(self, table: EventsTable) -> None:
        self._bounds = Bounds(on=0.6, off=0.35, after_s=table.fall_s, ends_s=1.0)

    def begin(self) -> Memory:
        """See `Rule.begin`."""
        return Memory({}, {})

    def advance(self, memory: Memory, snapshot: Snapshot) -> tuple[Memory, list[PersonEvent]]:
        """See `Rule.advance`."""
        on_floor = snapshot.on_floor(memory.intervals)
        turned = turn(memory.intervals, on_floor, snapshot.time_ns, self._bounds)
        descents = {track: memory.descents.get(track, Descent(0, 0)) for track in turned.intervals}
        for track, interval in turned.intervals.items():
            person = snapshot.shown.get(track)
            if person is not None and snapshot.time_ns - interval.since_ns < 1e9:
                descents[track] = max(descents[track], descent_of(person), key=Descent.of_fall)
        events = []
        for track, interval in turned.begun.items():
            score = self._score(snapshot.known[track], descents[track])
            if score >= 0.5:
                events.append(snapshot.event("fall", "begun", track, interval, "fell", score))
        return Memory(turned.intervals, descents), events

    def _score(self, person: Person, descent: Descent) -> float:
        """Return the probability of a fall of somebody who has been on the floor for a while."""
        pace, lying = descent.least
        if descent.drop < LEAST_DROP or person.lies < lying:
            return 0.0
        return float(1 / (1 + np.exp(-(descent.pace - pace) / (0.5 * FAST_SPREAD))))


def why_not(memory: Memory, person: Person) -> str:
    """Return why somebody on the floor is told as no fall, in words; empty where nothing speaks.

    Args:
        memory: of the rule.
        person: who is on the floor.
    """
    descent = memory.descents.get(person.track)
    if descent is None:
        return "the way down was not seen"
    if descent.drop < LEAST_DROP:
        share = (
            f"{100 * descent.drop:.0f} % of the stature, and a fall takes {100 * LEAST_DROP:.0f}"
        )
        return f"the hips came down by {share} %"
    pace, lying = descent.least
    if person.lies < lying:
        return f"sat there rather than lay ({100 * person.lies:.0f} % lying)"
    if descent.pace < pace:
        return f"went down slowly: pace {descent.pace:.2f}, and a fall has {pace:.2f}"
    return ""
