"""Looks that a consumer of slot records asks the planner for."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LookRequest:
    """A request by a consumer of records, which holds until its next one.

    Attributes:
        cameras: that look in a slot at least; energy is borrowed for it for some seconds. 0 asks
            for none.
        tracks: people whom they are to show.
        enough_per_s: looks a second of all cameras that are enough, where cameras may rest.
    """

    cameras: float = 0.0
    tracks: tuple[int, ...] = ()
    enough_per_s: float = math.inf


NO_REQUEST = LookRequest()
