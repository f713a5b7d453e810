"""Whom an edge hands its slots to: who keeps them, and who learns from them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from e3pose.pipeline import SlotRecord
from e3pose.predict.base import Predictor
from e3pose.store.rows import Event

if TYPE_CHECKING:
    from e3pose.store.writer import WriterStatus


class Sink(Protocol):
    """Who keeps what happened; `store.StoreWriter` is one. Its methods return at once."""

    def append(
        self,
        record: SlotRecord,
        *,
        time_ns: int | None = None,
        energy_j: NDArray[np.float64] | None = None,
        wait: bool = False,
    ) -> bool:
        """Keep a slot."""
        ...

    def event(self, event: Event) -> bool:
        """Keep an event."""
        ...

    def status(self) -> WriterStatus:
        """Return how the keeping goes."""
        ...


class Learner(Protocol):
    """Who improves the predictor while the edge runs; `learning.OnlineTrainer` is one."""

    def collect(self, record: SlotRecord) -> None:
        """Take in a slot."""
        ...

    def poll(self) -> Predictor | None:
        """Return a better predictor to use from now on, if there is one."""
        ...
