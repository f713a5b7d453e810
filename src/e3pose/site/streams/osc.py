"""OSC over UDP: one bundle per person and slot.

/e3pose/slot            slot, seconds since 1970, people
/e3pose/person/TRACK/JOINT   x, y, z in metres, z up; joints that are known
/e3pose/zone/NAME       enter | dwell | leave, track, people in the zone, seconds stayed
/e3pose/event/KIND      begun | ended, track, zone, score, its sentence
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.udp_client import UDPClient

from e3pose.events.watch import Watch
from e3pose.model.person_event import PersonEvent
from e3pose.model.zone_event import ZoneEvent
from e3pose.site.connect import LiveSlot, Names
from e3pose.site.streams.as_json import event_words
from e3pose.site.streams.base import Source, host_port

PORT = 9000


def open_stream(place: str, source: Source) -> OscStream:
    """Return a stream of UDP packets to `HOST:PORT`, received or not."""
    return OscStream(UDPClient(*host_port(place, PORT)), source.names)


class OscStream:
    """See `Stream`."""

    def __init__(self, client: UDPClient, names: Names) -> None:
        """Send with a client, and the names of people."""
        self._client, self._names = client, names

    def slot(self, slot: LiveSlot) -> None:
        """See `Stream.slot`."""
        seconds = (slot.time_ns / 1e9, "d")
        self._client.send(message("/e3pose/slot", (slot.slot, "h"), seconds, (len(slot), "i")))
        people = slot.people
        for track, joints_m in zip(people.track_ids.tolist(), people.joints_m, strict=True):
            bundle = OscBundleBuilder(IMMEDIATELY)
            for name, place in zip(slot.joints, joints_m, strict=True):
                if np.isfinite(place).all():
                    address = f"/e3pose/person/{track}/{name}"
                    bundle.add_content(message(address, *((v, "f") for v in place.tolist())))
            self._client.send(bundle.build())

    def zone(self, event: ZoneEvent) -> None:
        """See `Stream.zone`."""
        said = (event.kind, "s"), (event.track, "i"), (event.count, "i"), (event.stayed_s, "f")
        self._client.send(message(f"/e3pose/zone/{event.zone}", *said))

    def people(self, watch: Watch, events: Sequence[PersonEvent]) -> None:
        """See `TellsPeople.people`."""
        for event in events:
            said = (event.phase, "s"), (event.track, "i"), (event.zone, "s"), (event.score, "f")
            words = (event_words(event, self._names)["sentence"], "s")
            self._client.send(message(f"/e3pose/event/{event.kind}", *said, words))

    def close(self) -> None:
        """See `Stream.close`."""
        self._client._sock.close()


def message(address: str, *values: tuple[object, str]) -> OscMessage:
    """Return a message of values, each with its type tag."""
    builder = OscMessageBuilder(address)
    for value, kind in values:
        builder.add_arg(value, kind)  # type: ignore[arg-type]
    return builder.build()
