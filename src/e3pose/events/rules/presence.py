"""The number of people: nobody for long, or too many."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from e3pose.events.intervals import Bounds, Interval, turn
from e3pose.events.people import Persons
from e3pose.events.rules.base import Snapshot
from e3pose.events.states import LYING, SITTING
from e3pose.model.person_event import NOBODY, PersonEvent
from e3pose.settings.events_table import EventsTable


class Left:
    """`left`: once, when somebody who sat or lay on it is off it for two seconds."""

    def __init__(self, table: EventsTable) -> None:
        self._bounds = Bounds(on=0.6, off=0.4, after_s=table.settled_s, ends_s=2.0)

    def begin(self) -> Mapping[int, Interval]:
        """See `Rule.begin`."""
        return {}

    def advance(
        self, memory: Mapping[int, Interval], snapshot: Snapshot
    ) -> tuple[Mapping[int, Interval], list[PersonEvent]]:
        """See `Rule.advance`."""
        values = {
            track: float(person.states[[LYING, SITTING]].sum()) if person.surface_m else 0.0
            for track, person in snapshot.shown.items()
        }
        turned = turn(memory, values, snapshot.time_ns, self._bounds)
        events = [
            snapshot.event("left", "ended", track, interval, "left", interval.most)
            for track, interval in turned.ended.items()
        ]
        return turned.intervals, events


MANY_S = 3.0
Intervals = Mapping[int, Interval]


class Presence:
    """An event about all people together, from when it has been so for a while until it ends."""

    def __init__(
        self, kind: str, says: str, bounds: Bounds, is_so: Callable[[Persons], bool]
    ) -> None:
        self._kind, self._says, self._bounds, self._is_so = kind, says, bounds, is_so

    def begin(self) -> Intervals:
        """See `Rule.begin`."""
        return {}

    def advance(self, memory: Intervals, snapshot: Snapshot) -> tuple[Intervals, list[PersonEvent]]:
        """See `Rule.advance`."""
        values = {NOBODY: float(self._is_so(snapshot.shown))}
        turned = turn(memory, values, snapshot.time_ns, self._bounds)
        begun = [
            snapshot.event(self._kind, "begun", NOBODY, interval, self._says)
            for interval in turned.begun.values()
        ]
        ended = [
            snapshot.event(self._kind, "ended", NOBODY, interval, self._says)
            for interval in turned.ended.values()
        ]
        return turned.intervals, begun + ended


def nobody_seen(table: EventsTable) -> Presence:
    """Return `nobody`: begun after `nobody_s` without anybody, ended when somebody comes."""
    bounds = Bounds(after_s=table.nobody_s, ends_s=0.5)
    return Presence(
        "nobody", "nobody seen", bounds, lambda people: bool(table.nobody_s) and not people
    )


def too_many(table: EventsTable) -> Presence:
    """Return `too-many`: begun when more than `most_people` are there for three seconds."""
    most, bounds = table.most_people, Bounds(after_s=MANY_S, ends_s=MANY_S)
    return Presence("too-many", "too many people", bounds, lambda people: 0 < most < len(people))
