"""Modes of a camera and their costs: looks and rests, one table a camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

RestName = Literal["idle", "not-capturing", "asleep", "suspended"]
LookName = Literal["whole", "part", "tracked", "gate", "nothing"]
RESTS: tuple[RestName, ...] = ("idle", "not-capturing", "asleep", "suspended")
# In which a camera says nothing.
RESTING: tuple[Literal["asleep", "suspended"], ...] = ("asleep", "suspended")
LOOKS: tuple[LookName, ...] = ("whole", "part", "tracked", "gate", "nothing")

# Seconds to the first frame where a profile states none, as of USB cameras: with less the first
# view after a rest is late, with more cameras rest less; an edge learns each camera's own.
WAKE_S = 0.5
SLOT_S = 0.04  # of a look whose joules a profile states by its power alone: 25 slots per second
NOT_STATED = "not stated"


@dataclass(frozen=True, slots=True)
class Rest:
    """A rest of a camera between looks.

    Attributes:
        name: one of `RESTS`: `idle` captures and runs no network; `not-capturing` has closed its
            source and still hears orders; `asleep` neither captures nor is reachable, the program
            waits; `suspended` is a suspended machine.
        watts: of the whole device.
        enter_s: from the last look or the order until it draws that.
        wake_s: from the alarm to the first frame, mean.
        wake_sd_s: standard deviation of `wake_s`.
        source: where the row is from.
    """

    name: str
    watts: float
    enter_s: float = 0.0
    wake_s: float = 0.0
    wake_sd_s: float = 0.0
    source: str = NOT_STATED


@dataclass(frozen=True, slots=True)
class Look:
    """A way to look in one slot.

    Attributes:
        name: one of `LOOKS`: `whole` detects in all of an image, `part` where people are expected,
            `tracked` follows the keypoints of the look before, `gate` compares a small image with
            that of the look before, `nothing` is a slot without a look.
        joules: that it takes beyond an idle slot.
        latency_s: from frame to view; 0 where the table does not state it.
        source: where the row is from.
    """

    name: str
    joules: float
    latency_s: float = 0.0
    source: str = NOT_STATED


@dataclass(frozen=True, slots=True)
class CameraModes:
    """The table of one camera. A mode without a row is one that the camera does not have.

    Attributes:
        looks: in the order of `LOOKS`.
        rests: in the order of `RESTS`, each drawing at most as much as the one before.
        table: which table this is, for people.
    """

    looks: tuple[Look, ...]
    rests: tuple[Rest, ...]
    table: str = NOT_STATED

    def look(self, name: LookName) -> Look | None:
        """Return a look; None where the camera does not have it."""
        return next((look for look in self.looks if look.name == name), None)

    def rest(self, name: RestName) -> Rest | None:
        """Return a rest; None where the camera does not have it."""
        return next((rest for rest in self.rests if rest.name == name), None)
