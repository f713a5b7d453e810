"""A store writer that also stores events of zones and of people."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from e3pose.events import watch as watching
from e3pose.events.people import Seen
from e3pose.events.states import STATES
from e3pose.events.watch import Watch, looks_of
from e3pose.model.look_request import NO_REQUEST, LookRequest
from e3pose.model.person_event import PersonEvent, sentence
from e3pose.pipeline import SlotRecord
from e3pose.settings.resolved import ResolvedSite
from e3pose.site.zones import Zones, advance
from e3pose.store.rows import Event, Presence

if TYPE_CHECKING:
    from e3pose.store.writer import StoreWriter, WriterStatus


@dataclass(eq=False)
class EventSink:
    """Hands slots and their events on to a writer.

    Attributes:
        writer: of the store.
        zones: who is in which.
        watch: who does what; None where the site does not ask for it.
    """

    writer: StoreWriter
    zones: Zones
    watch: Watch | None = None
    _wanted: ResolvedSite | None = None

    def rezone(self, site: ResolvedSite) -> None:
        """Use the zones of a site from the next slot on; may be called on any thread."""
        self._wanted = site

    def append(
        self,
        record: SlotRecord,
        *,
        time_ns: int | None = None,
        energy_j: NDArray[np.float64] | None = None,
        wait: bool = False,
    ) -> bool:
        """Store a slot and its events."""
        taken = self.writer.append(record, time_ns=time_ns, energy_j=energy_j, wait=wait)
        if self._wanted is not None:
            site, self._wanted = self._wanted, None
            self.zones = Zones(site.file.zone)
            if self.watch is not None:
                self.watch = replace(self.watch, zones=site.file.zone)
        if time_ns is not None and (self.zones.tables or self.watch is not None):
            seen = Seen(record.slot, time_ns, record.people)
            self.zones, events = advance(self.zones, seen)
            for event in events:
                self.writer.zone(event)
            if self.watch is not None:
                failed = self.watch.faults
                self.watch, told = watching.advance(self.watch, seen)
                for kind, why in self.watch.faults.items():
                    if kind not in failed:
                        self.writer.event(Event(time_ns, "rule-failed", f"{kind}: {why}"))
                for each in told:
                    self.writer.event(stored(each))
                if self.watch.slot == record.slot:
                    self.writer.present(presence(self.watch))
        return taken

    def request(self) -> LookRequest:
        """Return the looks that open events request."""
        return NO_REQUEST if self.watch is None else looks_of(self.watch)

    def event(self, event: Event) -> bool:
        """Keep an event."""
        return self.writer.event(event)

    def status(self) -> WriterStatus:
        """Return how the keeping goes."""
        return self.writer.status()


def stored(event: PersonEvent) -> Event:
    """Return an event of a person as a store keeps it."""
    return Event(
        event.time_ns, event.kind, sentence(event), track_id=event.track, zone=event.zone,
        phase=event.phase, start_ns=event.start_ns, score=event.score,
    )  # fmt: skip


def presence(watch: Watch) -> Presence:
    """Return the states of people in the newest slot."""
    people = [person.states for person in watch.shown.values()]
    counts = np.sum(people, axis=0).tolist() if people else ()
    return Presence(watch.time_ns, dict(zip(STATES, counts, strict=False)))
