"""Somebody lies or sits on the floor for long, however they got there; and gets up again."""

from __future__ import annotations

from collections.abc import Mapping

from e3pose.events.intervals import Bounds, Interval, turn
from e3pose.events.rules.base import Moment
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
        self, memory: Mapping[int, Interval], moment: Moment
    ) -> tuple[Mapping[int, Interval], list[PersonEvent]]:
        """See `Rule.advance`."""
        turned = turn(memory, moment.on_floor(memory), moment.time_ns, self._bounds)
        events = [
            moment.event("on-floor", "begun", track, interval, "is on the floor", interval.most)
            for track, interval in turned.begun.items()
        ] + [
            moment.event("on-floor", "ended", track, interval, "was on the floor", interval.most)
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
        self, memory: Mapping[int, Interval], moment: Moment
    ) -> tuple[Mapping[int, Interval], list[PersonEvent]]:
        """See `Rule.advance`."""
        values = {track: person.on_floor for track, person in moment.shown.items()}
        intervals = dict(turn(memory, values, moment.time_ns, self._down).intervals)
        events = []
        for track, person in moment.shown.items():
            interval, states = intervals.get(track), person.states
            up = float(states[STANDING] + states[WALKING])
            if interval is None or not interval.told or up < SURE:
                continue
            if moment.time_ns - interval.held_ns > UP_S * 1e9:
                events.append(moment.event("got-up", "ended", track, interval, "got up", up))
                del intervals[track]
        return intervals, events
