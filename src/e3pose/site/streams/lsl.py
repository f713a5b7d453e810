"""Lab Streaming Layer: an outlet of poses, and one of zone events as markers.

The channels of a stream are fixed, so there is room for `PEOPLE` people: for each the track id,
then x, y, z and sigma of each joint, metres. A person keeps the place until gone; NaN is nobody.
"""

from __future__ import annotations

import time

import numpy as np
import pylsl

from e3pose.model.zone_event import ZoneEvent
from e3pose.site.connect import LiveSlot
from e3pose.site.streams.base import Source

PEOPLE = 4
KEPT_S = 2  # of samples for a recorder that does not take them; the library keeps 360 s otherwise
PARTS = ("x", "y", "z", "sigma")


def open_stream(place: str, source: Source) -> LslStream:
    """Return a stream under a name, `e3pose` by default; its markers are `NAME-zones`."""
    return LslStream(place or "e3pose", source)


class LslStream:
    """See `Stream`."""

    def __init__(self, name: str, source: Source) -> None:
        """Announce both outlets on the network."""
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
        self._zones = pylsl.StreamOutlet(
            pylsl.StreamInfo(
                f"{name}-zones", "Markers", 1, pylsl.IRREGULAR_RATE, pylsl.cf_string,
                f"e3pose-{source.site}-{name}-zones",
            )
        )  # fmt: skip
        self._places: list[int | None] = [None] * PEOPLE

    def slot(self, slot: LiveSlot) -> None:
        """See `Stream.slot`; the time stamp is that of the slot's middle."""
        row = {int(track): index for index, track in enumerate(slot.track_ids)}
        self._places = [track if track in row else None for track in self._places]
        for track in row:
            if track not in self._places and None in self._places:
                self._places[self._places.index(None)] = track
        sample = np.full((PEOPLE, self._width), np.nan)
        for place, there in enumerate(self._places):
            if there is not None:
                sample[place, 0] = there
                parts = (slot.joints_m[row[there]], slot.sigma_m[row[there]][:, None])
                sample[place, 1:] = np.concatenate(parts, axis=1).ravel()
        self._poses.push_sample(sample.ravel().tolist(), _stamp(slot.time_ns))

    def zone(self, event: ZoneEvent) -> None:
        """See `Stream.zone`; a marker reads `enter door 7 2`: kind, zone, track, people."""
        said = f"{event.kind} {event.zone} {event.track} {event.count}"
        self._zones.push_sample([said], _stamp(event.time_ns))

    def close(self) -> None:
        """See `Stream.close`."""
        del self._poses, self._zones


def _stamp(time_ns: int) -> float:
    """Return a time of day by LSL's clock, taken to be as exact as both machines' clocks."""
    return float(pylsl.local_clock() - (time.time_ns() - time_ns) / 1e9)
