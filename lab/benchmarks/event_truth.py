"""What should be told of simulated episodes, and what may be: windows of time by kind of event."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from e3pose.model.person_event import PersonEvent
from e3pose.settings.events_table import EventsTable
from e3pose.simulate.episodes import FALLS, LOW, Episode
from e3pose.simulate.gestures import RAMP_S, Gesturing

SOON_S = 1.0  # something may be told so long before a body has got there
LATE_S = 6.0  # what is due so near to the end of a recording does not count
SLIDE = "slide-down"
LIES_DEG = 45.0  # trunk from the vertical: who is on the floor and more upright sits
WAVES_S = 2.5  # who waves for so long has to be told
ENDS_S = 8.0  # getting up, or off a bed, is told so long after at most


@dataclass(frozen=True, slots=True)
class Due:
    """An event that should be told.

    Attributes:
        kind: of the event.
        what: it is of, an episode.
        since_s: from when on it is so, of which the delay counts.
        until_s: it must be told before.
        must: whether it has to be told; otherwise it may be, and is then no false alarm.
    """

    kind: str
    what: str
    since_s: float
    until_s: float
    must: bool = True

    def covers(self, event: PersonEvent, late_s: float = 0.0) -> bool:
        """Return whether an event is this one."""
        at_s = event.time_ns / 1e9
        return event.kind == self.kind and self.since_s - SOON_S < at_s < self.until_s + late_s


def due_of(lived: Sequence[Episode], table: EventsTable, seconds: float) -> list[Due]:
    """Return what is due in a recording of so many seconds; near to its end it only may be told."""
    return [
        replace(due, must=due.must and due.since_s < seconds - LATE_S)
        for episode in lived
        for due in _due(episode, table)
    ]


def waves_of(gestures: Sequence[Gesturing], seconds: float) -> list[Due]:
    """Return the waves that are due in a recording of so many seconds."""
    return [
        Due(
            "waved", "wave", one.start_s + RAMP_S, one.stop_s,
            one.stop_s - one.start_s > WAVES_S + 2 * RAMP_S and one.stop_s < seconds - LATE_S,
        )
        for one in gestures
        if one.name == "wave"
    ]  # fmt: skip


def _due(episode: Episode, table: EventsTable) -> Iterator[Due]:
    times_s = episode.start_s + np.cumsum([key.after_s for key in episode.keys])
    kind, ends_s = episode.kind, episode.stop_s + ENDS_S
    low = [key.pelvis[2] < LOW and key.lift_m == 0 for key in episode.keys]
    raised = [key.lift_m > 0 for key in episode.keys]
    if True in raised:
        first, last = raised.index(True), len(raised) - 1 - raised[::-1].index(True)
        settled = times_s[last] - times_s[first] > table.settled_s + 2
        yield Due("left", kind, float(times_s[last]), ends_s, bool(settled))
    if True not in low:
        return
    first, last = low.index(True), len(low) - 1 - low[::-1].index(True)
    down_s, up_s = float(times_s[first]), float(times_s[last])
    key = episode.keys[last]
    lies_deg = np.degrees(np.arccos(np.clip(np.cos(key.pitch) * np.cos(key.roll), -1, 1)))
    if kind in FALLS:
        called = "fall" if lies_deg >= LIES_DEG else "fall that ends sitting"
        yield Due("fall", called if kind != SLIDE else f"slow {called}", down_s, episode.stop_s)
    whole = all(low[first : last + 1])
    long = whole and up_s - down_s > table.lies_s + 2
    yield Due("on-floor", kind, down_s + table.lies_s, ends_s, long)
    up = whole and up_s - down_s > 4 and last + 1 < len(low)
    yield Due("got-up", kind, up_s, ends_s, up)
