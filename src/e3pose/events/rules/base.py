"""The Protocol of a rule: the people of a slot in, events out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

from e3pose.events.intervals import Interval
from e3pose.events.people import Persons
from e3pose.model.person_event import PersonEvent, Phase


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """The people of one slot, as rules of events see them.

    Attributes:
        slot: its number.
        time_ns: nanoseconds since 1970.
        shown: the people that are shown in it, by track.
        known: these and people who were lost in the last seconds.
    """

    slot: int
    time_ns: int
    shown: Persons
    known: Persons

    def on_floor(self, intervals: Mapping[int, Interval]) -> dict[int, float]:
        """Return how likely each person is on the floor; 0.5 of one not shown who was there.

        Somebody who is not shown for a moment has not got up.
        """
        hidden = {track: 0.5 for track in intervals if track in self.known}
        return hidden | {track: person.on_floor for track, person in self.shown.items()}

    def event(
        self, kind: str, phase: Phase, track: int, interval: Interval, says: str, score: float = 1.0
    ) -> PersonEvent:
        """Return an event of a person that began with an interval and is told now."""
        person = self.known.get(track)
        zone, first = ("", track) if person is None else (person.near, person.first)
        score = round(min(max(score, 0.0), 1.0), 3)
        return PersonEvent(
            kind, phase, track, zone, interval.since_ns, self.time_ns, self.slot, score, says,
            first=first,
        )  # fmt: skip


class Rule(Protocol):
    """Tell events. A rule is stateless: it takes its memory and returns the next."""

    def begin(self) -> Any:
        """Return the memory before the first slot."""
        ...

    def advance(self, memory: Any, snapshot: Snapshot) -> tuple[Any, list[PersonEvent]]:
        """Return the memory after a slot, and its events."""
        ...


def inherited(memory: Any, heirs: Mapping[int, int]) -> Any:
    """Return the memory of a rule, with people by their present identities.

    Args:
        memory: a mapping by track or by a tuple that begins with one, or a record of such.
        heirs: identity before, by the one now.
    """
    if not isinstance(memory, Mapping):
        parts = {part.name: getattr(memory, part.name) for part in fields(memory)}
        return replace(memory, **{name: inherited(each, heirs) for name, each in parts.items()})
    now = {before: track for track, before in heirs.items()}

    def renamed(key: Any) -> Any:
        if isinstance(key, tuple):
            return (now.get(key[0], key[0]), *key[1:])
        return now.get(key, key)

    return {renamed(key): value for key, value in memory.items()}
