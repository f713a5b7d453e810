"""Whether an edge keeps up; and if it does, which of its cameras do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags
from e3pose.edge.delivery import Delivery, after_slot, shortages
from e3pose.edge.lateness import impairments
from e3pose.edge.lead import Lead
from e3pose.edge.overload import Load, after_work, level_change
from e3pose.edge.roster import CameraState
from e3pose.pipeline import SlotRecord
from e3pose.select.failure_detector import Silence


@dataclass(slots=True, eq=False)
class Health:
    """The load of an edge and what its cameras deliver; written by one thread, read by others.

    Attributes:
        num_cameras: of the rig.
        slot_s: seconds per slot.
        pace: seconds of the scene per second.
        warmup_slots: at the start, for which no policy selects.
        load: of the edge.
        delivery: of the cameras.
    """

    num_cameras: int
    slot_s: float
    pace: float
    warmup_slots: int = 0
    load: Load = field(default_factory=Load)
    delivery: Delivery = field(init=False)

    def __post_init__(self) -> None:
        self.delivery = Delivery.none(self.num_cameras)

    def after_slot(
        self,
        record: SlotRecord,
        wanted: Flags,
        views_late: Flags,
        orders_late: Flags,
        given_up: Flags,
        took_s: float,
        behind_s: float,
    ) -> str | None:
        """Add a slot; return the message of an event if the edge sheds more or less load.

        Args:
            record: of the slot.
            wanted: `(num_cameras,)` cameras that had an order in time and were online.
            views_late: `(num_cameras,)` cameras of which a view came too late.
            orders_late: `(num_cameras,)` cameras that lately received orders too late.
            given_up: `(num_cameras,)` cameras that the failure detector gave up.
            took_s: computing time.
            behind_s: how long after its deadline computing began.
        """
        before = self.load
        awake = int(record.selected.sum()) if record.slot >= self.warmup_slots else before.awake
        self.load = after_work(before, took_s, self.slot_s, awake, behind_s)
        fair = wanted & ~orders_late & (not self.load.overloaded())
        self.delivery = after_slot(
            self.delivery, fair, record.arrived, views_late, given_up, self.slot_s
        )
        return level_change(before, self.load)

    def impairments(
        self,
        silence: Silence,
        late_by_s: NDArray[np.float64],
        interval_s: float,
        lead: Lead,
        cameras: Sequence[CameraState],
    ) -> tuple[list[str], list[str]]:
        """Return for each camera why it is useless, and why it brings too few views; else empty.

        No camera is to blame while the edge is overloaded.

        Args:
            silence: of the failure detector.
            late_by_s: `(num_cameras,)` age of late views; NaN where none were late.
            interval_s: seconds of the scene per slot.
            lead: with the delays of orders.
            cameras: their states.
        """
        if self.load.overloaded():
            return [""] * len(cameras), [""] * len(cameras)
        useless = impairments(silence, late_by_s, interval_s, lead)
        return useless, shortages(self.delivery, cameras, 1 / self.slot_s, self.pace)
