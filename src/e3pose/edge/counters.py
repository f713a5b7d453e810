"""Counters and durations of an edge."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from e3pose.model.slot_record import SlotRecord

MAX_SAMPLES = 4096  # some minutes of slots
MINUTE_S = 60.0
SUSPENDED_S = 60.0  # away at once: no slow edge, whose slots per second would count it


@dataclass(slots=True, eq=False)
class Durations:
    """The newest durations of one operation."""

    samples_ns: deque[int] = field(default_factory=lambda: deque(maxlen=MAX_SAMPLES))

    def add(self, duration_ns: int) -> None:
        """Add one."""
        self.samples_ns.append(duration_ns)

    def median_and_99_ms(self) -> tuple[float, float]:
        """Return the median and the 99th percentile in milliseconds; 0 before the first sample."""
        samples = list(self.samples_ns)  # another thread may add meanwhile
        if not samples:
            return 0.0, 0.0
        median, high = np.quantile(samples, [0.5, 0.99]) / 1e6
        return float(median), float(high)


@dataclass(slots=True, eq=False)
class Counts:
    """Counters of a running edge.

    Attributes:
        num_cameras: of the rig.
        interval_s: seconds per slot.
        slots: slots computed.
        lost: slots skipped.
        views: views that arrived in time.
        ordered: `(num_cameras,)` slots for which each camera was selected.
        missed: `(num_cameras,)` of those, slots without a view in time.
        blind: blind slots by cause; replaced whole, as another thread reads it.
        first_ns: when the first slot was computed, and later by what the machine was suspended.
        latency: from the last view's arrival to the poses.
        stepping: computing of a slot.
    """

    num_cameras: int
    interval_s: float
    slots: int = 0
    lost: int = 0
    views: int = 0
    ordered: NDArray[np.int64] = field(init=False)
    missed: NDArray[np.int64] = field(init=False)
    blind: dict[str, int] = field(default_factory=dict)
    first_ns: int | None = None
    latency: Durations = field(default_factory=Durations)
    stepping: Durations = field(default_factory=Durations)
    # Of the last minute's slots: whether each camera was active, then whether the slot was blind.
    _minute: deque[NDArray[np.int64]] = field(default_factory=deque)
    _sums: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        self.ordered = np.zeros(self.num_cameras, dtype=np.int64)
        self.missed = np.zeros(self.num_cameras, dtype=np.int64)
        self._sums = np.zeros(self.num_cameras + 1, dtype=np.int64)

    def count_slot(
        self,
        views: int,
        wanted: NDArray[np.bool_],
        record: SlotRecord,
        begun_ns: int,
        took_ns: int,
    ) -> None:
        """Add a slot.

        Args:
            views: those that came in time.
            wanted: `(num_cameras,)` cameras that were reachable and had an order in time.
            record: of the slot.
            begun_ns: when computing it began.
            took_ns: to compute it.
        """
        self.first_ns = self.first_ns or begun_ns
        self.slots += 1
        self.views += views
        self.ordered += wanted
        self.missed += wanted & ~record.arrived
        self.stepping.add(took_ns)
        if record.blind:
            self.blind = {**self.blind, record.blind: self.blind.get(record.blind, 0) + 1}
        counted = np.zeros(self.num_cameras + 1, dtype=np.int64)
        if record.blind:
            counted[-1] = 1
        else:
            counted[:-1] = record.selected
        self._minute.append(counted)
        if len(self._minute) > max(1, round(MINUTE_S / self.interval_s)):
            counted = counted - self._minute.popleft()
        self._sums = self._sums + counted  # replaced whole: another thread reads it

    def skip(self, slots: int) -> None:
        """Count skipped slots; a gap of `SUSPENDED_S` or more was a suspension of the machine."""
        self.lost += slots
        away_s = slots * self.interval_s
        if self.first_ns is not None and away_s >= SUSPENDED_S:
            self.first_ns += round(away_s * 1e9)

    def duty(self) -> NDArray[np.float64]:
        """Return `(num_cameras,)`: share of the last minute's slots in which each was active.

        Blind slots are left out, as in `blind_slot.duty`.
        """
        sums = self._sums
        return np.asarray(sums[:-1] / max(len(self._minute) - int(sums[-1]), 1))

    def blind_share(self) -> float:
        """Return the share of the last minute's slots that were blind."""
        return float(self._sums[-1] / max(len(self._minute), 1))

    def fps(self, now_ns: int) -> float:
        """Return slots per second since the first, while the machine was not suspended."""
        if self.first_ns is None:
            return 0.0
        run_s = max((now_ns - self.first_ns) / 1e9, self.interval_s)
        return min(self.slots / run_s, 2 / self.interval_s)  # a slot is no measurement
