"""Times of a camera active, idle and asleep: one owner for its heartbeats and its meter.

A camera is active for the length of one slot whenever its network begins to look, however long the
network takes. So each slot in which it looked counts once, as queues, budgets and the edge's ledger
count it, and the power learned of active time, times a slot's length, is what such a slot costs.
A slot whose image the motion gate found unchanged, or whose frame was dropped, is idle time.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from e3pose.energy.modes import RESTING
from e3pose.energy.profiles import Activity


@dataclass(frozen=True, slots=True)
class ModeTimes:
    """The mode of a camera at a moment, and its time in each mode until then.

    Attributes:
        at_ns: the moment.
        mode: what it does.
        spent_ns: time in each mode so far. A slot in which the camera looks counts as active from
            its begin, and is time that other modes then lack.
        idle_ns: time neither active nor asleep; it never falls.
    """

    at_ns: int
    mode: Activity
    spent_ns: Mapping[Activity, int] = field(default_factory=dict)
    idle_ns: int = 0

    def seconds_since(self, before: ModeTimes) -> dict[Activity, float]:
        """Return the seconds in each mode since an earlier moment."""
        spent = self.spent_ns.items()
        return {mode: (ns - before.spent_ns.get(mode, 0)) / 1e9 for mode, ns in spent}

    def fields(self) -> dict[str, Any]:
        """Return the fields of a heartbeat that say this."""
        return {
            "mode": self.mode,
            "active_s": self.spent_ns.get("active", 0) / 1e9,
            "idle_s": self.idle_ns / 1e9,
            "asleep_s": sum(self.spent_ns.get(mode, 0) for mode in RESTING) / 1e9,
        }


class ModeClock:
    """Knows what a camera does, and for how long it did what; every method on any thread."""

    def __init__(self, now_ns: Callable[[], int], mode: Activity = "power-saving") -> None:
        """Begin to count.

        Args:
            now_ns: the camera's time, which never runs backwards.
            mode: what it does while it does not look.
        """
        self._now_ns, self._mode = now_ns, mode
        self._begun_ns = self._counted_ns = self._active_until_ns = now_ns()
        self._spent_ns: dict[Activity, int] = {}
        self._owed_ns = self._idle_ns = 0
        self._lock = threading.Lock()

    def change(self, mode: Activity) -> None:
        """Do something else from now on, where it does not look."""
        with self._lock:
            self._count()
            self._mode = mode

    def look(self, begin_ns: int, interval_ns: int) -> None:
        """Be active for a slot in place of the present mode.

        Args:
            begin_ns: when the slot's frame came.
            interval_ns: length of a slot.
        """
        with self._lock:
            self._count()
            self._active_until_ns = begin_ns + interval_ns
            self._owed_ns += interval_ns
            self._add("active", interval_ns)

    def times(self) -> ModeTimes:
        """Return the present mode, and the time in each so far."""
        with self._lock:
            now_ns, spent_ns = self._count(), dict(self._spent_ns)
            resting_ns = sum(spent_ns.get(mode, 0) for mode in RESTING)
            other_ns = spent_ns.get("active", 0) + resting_ns
            self._idle_ns = max(self._idle_ns, now_ns - self._begun_ns - other_ns)
            looks = now_ns < self._active_until_ns and self._mode not in RESTING
            return ModeTimes(now_ns, "active" if looks else self._mode, spent_ns, self._idle_ns)

    def _count(self) -> int:
        """Count the time since the last call; return the time."""
        now_ns = max(self._now_ns(), self._counted_ns)
        passed_ns, self._counted_ns = now_ns - self._counted_ns, now_ns
        paid_ns = 0 if self._mode in RESTING else min(self._owed_ns, passed_ns)
        self._owed_ns -= paid_ns
        self._add(self._mode, passed_ns - paid_ns)
        return now_ns

    def _add(self, mode: Activity, span_ns: int) -> None:
        self._spent_ns[mode] = self._spent_ns.get(mode, 0) + span_ns
