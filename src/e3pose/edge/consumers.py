"""Consumers of slot records: store, online learner, energy ledger."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from e3pose.edge.energy_ledger import EnergyLedger
from e3pose.energy.budgets import Budget
from e3pose.energy.saving import Saving
from e3pose.model.look_request import NO_REQUEST, LookRequest
from e3pose.pipeline import SlotRecord
from e3pose.select.policies.base import Policy
from e3pose.store.rows import Event
from e3pose.wire.messages import Heartbeat
from e3pose.wire.topics import ANY, of_control, of_outbox
from e3pose.wire.transport import Answer, Transport

if TYPE_CHECKING:
    from e3pose.edge.displacement import DisplacementWatch
    from e3pose.edge.gather import Arrival
    from e3pose.edge.learn import OnlineTrainer
    from e3pose.edge.recorder import Recorder
    from e3pose.store.writer import WriterStatus

Chosen = tuple[Policy, Callable[[float], Policy] | None]  # who selects, for any number of cameras


Spending = tuple[Sequence[Budget], float]  # what each camera may spend; cameras asked for


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """Requests of operators since the previous slot.

    Attributes:
        chosen: who selects from the next slot on; None if that stays.
        spending: the budgets from the next slot on; None if they stay.
        lines: messages for operators.
    """

    chosen: Chosen | None = None
    spending: Spending | None = None
    lines: Sequence[str] = ()


NOTHING_ASKED = Asked()


class Sink(Protocol):
    """Stores slots and events; `store.StoreWriter` is one. Its methods return at once."""

    def append(
        self,
        record: SlotRecord,
        *,
        time_ns: int | None = None,
        energy_j: NDArray[np.float64] | None = None,
        wait: bool = False,
    ) -> bool:
        """Store a slot."""
        ...

    def event(self, event: Event) -> bool:
        """Store an event."""
        ...

    def status(self) -> WriterStatus:
        """Return the status of the store."""
        ...


class Controls(Protocol):
    """Requests of operators to a running edge; `site.control.SiteControls` is one."""

    @property
    def paused(self) -> frozenset[str]:
        """Cameras that operators paused."""
        ...

    def answer(self, operator: str, payload: bytes) -> bytes:
        """Answer a `Control` of an operator; on a thread of the transport."""
        ...

    def applied(self) -> Asked:
        """Return the requests since the last call."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Consumers:
    """Consumers of received views and computed slots (store, recorder, learner).

    Attributes:
        sink: stores every slot.
        learner: improves the predictor.
        ledger: tracks what cameras spend and may spend.
        controls: requests of operators.
        recorder: writes the views of cameras as recordings.
        watch: detects that a camera was displaced.
        outbox: answers hubs that fetch summaries, on a thread of the transport.
        asks: returns after each slot the looks that are asked for.
    """

    sink: Sink | None = None
    learner: OnlineTrainer | None = None
    ledger: EnergyLedger | None = None
    controls: Controls | None = None
    recorder: Recorder | None = None
    watch: DisplacementWatch | None = None
    outbox: Answer | None = None
    asks: Callable[[], LookRequest] = lambda: NO_REQUEST

    def paused(self) -> frozenset[str]:
        """Return the cameras that operators paused."""
        return frozenset() if self.controls is None else self.controls.paused

    def listen(self, transport: Transport, site: str) -> None:
        """Start to answer operators and viewers."""
        if self.outbox is not None:
            transport.answer(of_outbox(site, ANY), self.outbox)
        controls = self.controls
        if controls is not None:
            transport.answer(
                of_control(site, ANY),
                lambda topic, asked: controls.answer(topic.rpartition("/")[2], asked),
            )

    def take(self, beat: Heartbeat) -> None:
        """Pass on a heartbeat; on a thread of the transport."""
        if self.ledger is not None:
            self.ledger.take(beat)
        if self.recorder is not None:
            self.recorder.processor.take(beat)

    def observe(self, record: SlotRecord, time_ns: int, arrivals: Mapping[int, Arrival]) -> None:
        """Pass on the looks of a slot, by camera, and its record.

        Views of unchanged images say nothing new; a recording of them would count as looks.
        """
        looks = {c: one for c, one in arrivals.items() if one.poses.unchanged_s <= 0}
        if self.recorder is not None:
            self.recorder.keep(record.slot, time_ns, looks)
        if self.watch is not None:
            self.watch.observe(record, {camera: one.poses for camera, one in looks.items()})

    def stored(self) -> WriterStatus | None:
        """Return how the store is doing; None without one."""
        return None if self.sink is None else self.sink.status()

    @property
    def saving(self) -> Saving | None:
        """Saving of whole cameras so far; None before the first slot or without a ledger."""
        return None if self.ledger is None else self.ledger.saving()

    @property
    def turned(self) -> tuple[int, float] | None:
        """The displaced camera and its rotation in degrees, or None."""
        found = None if self.watch is None else self.watch.found
        return None if found is None else (found.camera, found.degrees)

    @property
    def doubt(self) -> str:
        """Why scale or axes of the calibration cannot be right; empty if not known."""
        return "" if self.watch is None or self.watch.world is None else self.watch.world.words

    def keep(
        self, record: SlotRecord, time_ns: int, arrivals: Mapping[int, Arrival] | None = None
    ) -> None:
        """Pass on a computed slot with its energy."""
        spent_j = None
        if self.ledger is not None:
            unchanged = np.zeros(len(record.selected), dtype=bool)
            for camera, arrival in (arrivals or {}).items():
                unchanged[camera] = arrival.poses.unchanged_s > 0
            spent_j = self.ledger.charge(record.selected, unchanged, bool(record.blind))
        if self.sink is not None:
            self.sink.append(record, time_ns=time_ns, energy_j=spent_j)


NO_CONSUMERS = Consumers()
