"""What a camera has spent, time and energy of one moment: that at which a slot begins.

A heartbeat is made between two slots and two looks, as nobody knows how much of a look is drawn in
the middle of one, and not always after as many: in turns, each would hold the same share of looks.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from e3pose.energy.activity import ModeClock
from e3pose.energy.profiles import Activity

PAUSE_NS = 450_000_000  # from heartbeat to heartbeat on average, without the wait for a slot
SPREAD = 0.2
SLOT_WAIT_S = 0.2  # at most, for a slot to begin
WAITS = 3  # of these at most, while a look goes on


def pause_ns(draw: float) -> int:
    """Return how long to wait before the next heartbeat.

    Args:
        draw: a random number in [0, 1).
    """
    return round(PAUSE_NS * (1 + SPREAD * (2 * draw - 1)))


class Spending:
    """Takes what a camera spent for one thread, as another one says that a slot begins.

    Attributes:
        told: cleared while a slot is waited for.
    """

    def __init__(
        self,
        modes: ModeClock,
        meter: Callable[[Activity], dict[str, Any]],
        looks: Callable[[], bool] = lambda: False,
    ) -> None:
        """Begin.

        Args:
            modes: the time in each mode.
            meter: the power fields of a heartbeat, and those of time if it took them itself.
            looks: whether a look goes on.
        """
        self._modes, self._meter, self._looks = modes, meter, looks
        self.told = threading.Event()
        self.told.set()
        self._taken: deque[dict[str, Any]] = deque(maxlen=1)

    def now(self) -> dict[str, Any]:
        """Return the fields of a heartbeat on mode, time, power and energy."""
        times = self._modes.times()
        return {**times.fields(), **self._meter(times.mode)}

    def begin_slot(self, active: bool) -> None:
        """Take what was spent, if somebody waits; call it before the slot's look.

        Args:
            active: whether the camera is to look: what it does from now on.
        """
        if not self.told.is_set() and not self._looks():
            self._taken.append({**self.now(), **({"mode": "active"} if active else {})})
            self.told.set()

    def by_next_slot(self) -> dict[str, Any]:
        """Return what was spent when the next slot began; until now if none begins in time."""
        self._taken.clear()
        self.told.clear()
        for _ in range(WAITS):
            if self.told.wait(SLOT_WAIT_S) or not self._looks():
                break
        self.told.set()
        return self._taken.pop() if self._taken else self.now()
