"""Somebody left a bed or a seat: a zone with a height, after staying on it for a while."""

from __future__ import annotations

from collections.abc import Mapping

from e3pose.events.intervals import Bounds, Interval, turn
from e3pose.events.rules.base import Moment
from e3pose.events.states import LYING, SITTING
from e3pose.model.person_event import PersonEvent
from e3pose.settings.events_table import EventsTable


class Left:
    """`left`: once, when somebody who sat or lay on it is off it for two seconds."""

    def __init__(self, table: EventsTable) -> None:
        self._bounds = Bounds(on=0.6, off=0.4, after_s=table.settled_s, ends_s=2.0)

    def begin(self) -> Mapping[int, Interval]:
        """See `Rule.begin`."""
        return {}

    def advance(
        self, memory: Mapping[int, Interval], moment: Moment
    ) -> tuple[Mapping[int, Interval], list[PersonEvent]]:
        """See `Rule.advance`."""
        values = {
            track: float(person.states[[LYING, SITTING]].sum()) if person.surface_m else 0.0
            for track, person in moment.shown.items()
        }
        turned = turn(memory, values, moment.time_ns, self._bounds)
        events = [
            moment.event("left", "ended", track, interval, "left", interval.most)
            for track, interval in turned.ended.items()
        ]
        return turned.intervals, events
