"""Events of people: somebody fell, lies, got up, left the bed, waved; nobody is there."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timezone, tzinfo
from typing import Literal

Phase = Literal["begun", "ended"]
ONCE = ("got-up", "left", "waved")  # kinds that do not last: told once, as ended
NOBODY = -1  # the track of events that are about a place, not a person


@dataclass(frozen=True, slots=True)
class PersonEvent:
    """An event of a person, for somebody to be told.

    An event that lasts is told twice, when it has begun and when it has ended, with the same kind,
    track and start. One that does not last is told once, as ended.

    Attributes:
        kind: a name in `events.rules.RULES`.
        phase: whether it goes on.
        track: of the person, or `NOBODY`.
        zone: in which zone, or near which one; empty where there is none.
        start_ns: when it began, nanoseconds since 1970.
        time_ns: when this is told.
        slot: in which slot.
        score: probability that it is so, [0, 1].
        says: what happened, in the past tense, without who and when: `fell`, `left`.
        name: of the person, where one is known and may be told; empty otherwise.
        first: track by which the person was known first; it changes where somebody is lost.
    """

    kind: str
    phase: Phase
    track: int
    zone: str
    start_ns: int
    time_ns: int
    slot: int
    score: float
    says: str
    name: str = ""
    first: int = NOBODY

    @property
    def is_news(self) -> bool:
        """Whether this is the first message about the event."""
        return self.phase == "begun" or self.kind in ONCE


def who(event: PersonEvent) -> str:
    """Return how an event names its person; empty where it is of nobody."""
    return "" if event.track == NOBODY else event.name or f"Person {event.track}"


def sentence(event: PersonEvent, zone: tzinfo = timezone.utc) -> str:
    """Return an event as a caregiver reads it.

    Args:
        event: what happened.
        zone: time zone to tell the time in.
    """
    at = datetime.fromtimestamp(event.start_ns / 1e9, zone).strftime("%H:%M")
    where = f" ({event.zone})" if event.zone else ""
    text = f"{who(event)} {event.says}{where} at {at}".strip()
    return text[0].upper() + text[1:]
