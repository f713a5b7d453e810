"""Lab Streaming Layer: an outlet of poses, and markers of zone events and events of people.

The channels of a stream are fixed, so there is room for `PEOPLE` people: for each the track id,
then x, y, z and sigma of each joint, metres. A person keeps the place until gone; NaN is nobody.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
import pylsl

from e3pose.events.watch import Watch
from e3pose.model.person_event import PersonEvent
from e3pose.model.zone_event import ZoneEvent
from e3pose.site.connect import LiveSlot
from e3pose.site.streams.base import Source

PEOPLE = 4
KEPT_S = 2  # of samples for a recorder that does not take them; the library keeps 360 s otherwise
PARTS = ("x", "y", "z", "sigma")


def open_stream(place: str, source: Source) -> LslStream:
    """Return a stream NAME, `e3pose` by default; its markers: `NAME-zones`, `NAME-events`."""
    return LslStream(place or "e3pose", source)


class LslStream:
    """See `Stream`."""

    def __init__(self, name: str, source: Source) -> None:
        """Announce the outlets on the network."""
        joints = source.skeleton.joints
        self._width = 1 + len(joints) * len(PARTS)
        info = pylsl.StreamInfo(
            name, "MoCap", PEOPLE * self._width, source.fps, pylsl.cf_double64,
            f"e3pose-{source.site}-{name}",
        )  # fmt: skip
        channels = info.desc().append_child("channels")
        for person in range(PEOPLE):
            labels = [f"{joint}_{part}" for joint in joints for part in PARTS]
            for label in ("track", *labels):
                channel = channels.append_child("channel")
                channel.append_child_value("label", f"person{person}_{label}")
                channel.append_child_value("unit", "none" if label == "track" else "meters")
        info.desc().append_child_value("up_axis", "z")
        self._poses = pylsl.StreamOutlet(info, max_buffered=KEPT_S)
        self._zones, self._events = (
            pylsl.StreamOutlet(
                pylsl.StreamInfo(
                    f"{name}-{what}", "Markers", 1, pylsl.IRREGULAR_RATE, pylsl.cf_string,
                    f"e3pose-{source.site}-{name}-{what}",
                )
            )
            for what in ("zones", "events")
        )  # fmt: skip
        self._places: list[int | None] = [None] * PEOPLE

    def slot(self, slot: LiveSlot) -> None:
        """See `Stream.slot`; the time stamp is that of the slot's middle."""
        row = {int(track): index for index, track in enumerate(slot.people.track_ids)}
        self._places = [track if track in row else None for track in self._places]
        for track in row:
            if track not in self._places and None in self._places:
                self._places[self._places.index(None)] = track
        sample = np.full((PEOPLE, self._width), np.nan)
        for place, there in enumerate(self._places):
            if there is not None:
                sample[place, 0] = there
                parts = (slot.people.joints_m[row[there]], slot.people.sigma_m[row[there]][:, None])
                sample[place, 1:] = np.concatenate(parts, axis=1).ravel()
        self._poses.push_sample(sample.ravel().tolist(), _stamp(slot.time_ns))

    def zone(self, event: ZoneEvent) -> None:
        """See `Stream.zone`; a marker reads `enter door 7 2`: kind, zone, track, people."""
        said = f"{event.kind} {event.zone} {event.track} {event.count}"
        self._zones.push_sample([said], _stamp(event.time_ns))

    def people(self, watch: Watch, events: Sequence[PersonEvent]) -> None:
        """See `TellsPeople.people`; a marker reads `fall begun 7`: kind, phase, track."""
        for event in events:
            said = f"{event.kind} {event.phase} {event.track}"
            self._events.push_sample([said], _stamp(event.time_ns))

    def close(self) -> None:
        """See `Stream.close`."""
        del self._poses, self._zones, self._events


def _stamp(time_ns: int) -> float:
    """Return a time of day by LSL's clock, taken to be as exact as both machines' clocks."""
    return float(pylsl.local_clock() - (time.time_ns() - time_ns) / 1e9)
