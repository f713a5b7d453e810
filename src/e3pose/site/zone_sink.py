"""A store writer that also stores zone events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from e3pose.pipeline import SlotRecord
from e3pose.site.zones import Seen, Zones, advance
from e3pose.store.rows import Event

if TYPE_CHECKING:
    from e3pose.store.writer import StoreWriter, WriterStatus


@dataclass(eq=False)
class ZoneSink:
    """Hands slots on to a writer, and what happened in the zones.

    Attributes:
        writer: of the store.
        zones: who is in which.
    """

    writer: StoreWriter
    zones: Zones

    def append(
        self,
        record: SlotRecord,
        *,
        time_ns: int | None = None,
        energy_j: NDArray[np.float64] | None = None,
        wait: bool = False,
    ) -> bool:
        """Keep a slot and what happened in it."""
        taken = self.writer.append(record, time_ns=time_ns, energy_j=energy_j, wait=wait)
        if time_ns is not None:
            seen = Seen(record.slot, time_ns, record.track_ids, record.poses.joints_m)
            self.zones, events = advance(self.zones, seen)
            for event in events:
                self.writer.zone(event)
        return taken

    def event(self, event: Event) -> bool:
        """Keep an event."""
        return self.writer.event(event)

    def status(self) -> WriterStatus:
        """Return how the keeping goes."""
        return self.writer.status()
