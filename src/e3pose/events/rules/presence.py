"""How many people there are: nobody for long, or too many."""

from __future__ import annotations

from collections.abc import Mapping

from e3pose.events.rules.base import Moment
from e3pose.events.spells import Bounds, Spell, turn
from e3pose.model.person_event import NOBODY, PersonEvent
from e3pose.settings.events_table import EventsTable

MANY_S = 3.0
Spells = Mapping[int, Spell]


class Nobody:
    """`nobody`: begun after `nobody_s` without anybody, ended when somebody comes."""

    def __init__(self, table: EventsTable) -> None:
        self._bounds = Bounds(after_s=table.nobody_s, ends_s=0.5)
        self._asked = table.nobody_s > 0

    def begin(self) -> Spells:
        """See `Rule.begin`."""
        return {}

    def advance(self, memory: Spells, moment: Moment) -> tuple[Spells, list[PersonEvent]]:
        """See `Rule.advance`."""
        values = {NOBODY: float(self._asked and not moment.shown)}
        turned = turn(memory, values, moment.time_ns, self._bounds)
        return turned.spells, _told("nobody", moment, turned.begun, turned.ended, "nobody seen")


class TooMany:
    """`too-many`: begun when more than `most_people` are there for three seconds."""

    def __init__(self, table: EventsTable) -> None:
        self._bounds = Bounds(after_s=MANY_S, ends_s=MANY_S)
        self._most = table.most_people

    def begin(self) -> Spells:
        """See `Rule.begin`."""
        return {}

    def advance(self, memory: Spells, moment: Moment) -> tuple[Spells, list[PersonEvent]]:
        """See `Rule.advance`."""
        many = self._most > 0 and len(moment.shown) > self._most
        turned = turn(memory, {NOBODY: float(many)}, moment.time_ns, self._bounds)
        return turned.spells, _told(
            "too-many", moment, turned.begun, turned.ended, "too many people"
        )


def _told(kind: str, moment: Moment, begun: Spells, ended: Spells, says: str) -> list[PersonEvent]:
    return [moment.event(kind, "begun", NOBODY, spell, says) for spell in begun.values()] + [
        moment.event(kind, "ended", NOBODY, spell, says) for spell in ended.values()
    ]
