"""Trials: cameras that seldom answer are ordered now and then, to see whether they answer again.

A trial costs the others nothing. The camera is ordered beside the selected ones, not in place of
one, and where it needs a longer lead, its order leaves earlier and the others' do not. One camera
is tried at a time, and the pause before its next trial doubles each time that it fails.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Integers

TURN_S, EVERY_S = 1.0, 10.0  # the turn of a camera, and how often it comes
LONGEST_PAUSE = 4  # turns from one trial to the next
RELIABLE = 0.4  # share of answered orders below which a camera is tried, and which a trial asks for


class Trials:
    """Who is tried when; for one thread."""

    def __init__(self, num_cameras: int, interval_s: float) -> None:
        """Begin without a trial.

        Args:
            num_cameras: of the rig.
            interval_s: seconds per slot.
        """
        self._interval_s, self._first_s = interval_s, TURN_S * np.arange(num_cameras)
        self._pause = np.ones(num_cameras, dtype=np.int64)  # turns from one trial to the next
        self._turn = np.zeros(num_cameras, dtype=np.int64)  # whose orders are counted
        self._asked, self._answered = self._turn, self._turn
        self._planned: dict[int, int] = {}  # camera by slot

    def _since_s(self, slot: int) -> NDArray[np.float64]:
        """Return `(num_cameras,)`: seconds since some first turn of each camera."""
        return np.asarray(slot * self._interval_s + self._first_s)

    def _turns(self, slot: int) -> Integers:
        return np.asarray((self._since_s(slot) // EVERY_S).astype(np.int64))

    def whose(self, unreliable: Flags, slot: int) -> int | None:
        """Return the camera to order in a slot, for a later one; None where none is to be tried.

        Args:
            unreliable: `(num_cameras,)` cameras that can be reached but are not selected.
            slot: the present one.
        """
        turns = (self._since_s(slot) % EVERY_S < TURN_S) & (self._turns(slot) % self._pause == 0)
        tried = np.flatnonzero(unreliable & turns)
        return int(tried[0]) if len(tried) else None

    def plan(self, slot: int, camera: int) -> None:
        """Order a camera for a slot, whoever is selected for it."""
        self._planned[slot] = camera

    def take(self, slot: int) -> Flags:
        """Return `(num_cameras,)`: the camera planned for a slot; forget it and those before."""
        planned = np.zeros(len(self._pause), dtype=bool)
        if slot in self._planned:
            planned[self._planned[slot]] = True
        self._planned = {s: camera for s, camera in self._planned.items() if s > slot}
        return planned

    def observe(self, slot: int, tried: Flags, arrived: Flags) -> None:
        """Count a slot.

        Args:
            slot: which.
            tried: `(num_cameras,)` cameras with an order that seldom answer.
            arrived: `(num_cameras,)` cameras whose view came in time.
        """
        turns = self._turns(slot)
        over = turns > self._turn
        failed = over & (self._answered < RELIABLE * self._asked)
        passed = over & (self._asked > 0) & ~failed
        self._pause = np.where(passed, 1, np.where(failed, 2 * self._pause, self._pause))
        self._pause = np.minimum(self._pause, LONGEST_PAUSE)
        self._turn = turns
        self._asked = np.where(over, 0, self._asked) + tried
        self._answered = np.where(over, 0, self._answered) + (tried & arrived)
