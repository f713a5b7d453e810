"""Zone events: a person enters, stays in or leaves a zone of the floor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["enter", "dwell", "leave"]


@dataclass(frozen=True, slots=True)
class ZoneEvent:
    """Somebody entered a zone, has stayed in it for its `dwell_s`, or left it.

    Attributes:
        kind: which of the three.
        zone: name of the zone.
        track: of the person.
        count: people in the zone from now on.
        stayed_s: for how long the person has been in it.
        slot: in which slot.
        time_ns: when, nanoseconds since 1970.
    """

    kind: Kind
    zone: str
    track: int
    count: int
    stayed_s: float
    slot: int
    time_ns: int
