"""Collect the views of each slot until all have arrived or its deadline has passed."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from e3pose.base.clock import Clock
from e3pose.model.pose import Poses2D

MAX_AHEAD_SLOTS = 64  # a view farther ahead than any order comes from a wrong clock
LATEST = 25  # late views whose age is kept: about a second of them
WAIT_NS = 50_000_000  # longest sleep between checks of which cameras are online


@dataclass(frozen=True, slots=True)
class Arrival:
    """A view and when it arrived.

    Attributes:
        poses: its 2D poses.
        captured_ns: when its frame was taken, edge time.
        arrived_ns: when it arrived.
    """

    poses: Poses2D
    captured_ns: int
    arrived_ns: int


@dataclass(slots=True, eq=False)
class Gather:
    """The views of open slots, by slot and camera; bounded and thread-safe.

    Attributes:
        num_cameras: of the rig.
        slot: the oldest slot that is still open.
        views: `(num_cameras,)` views that arrived, in time or not.
        late: `(num_cameras,)` views that arrived after their slot was closed.
        newest_late: `(num_cameras,)` whether the newest view of each was one of these.
    """

    num_cameras: int
    slot: int = 0
    views: NDArray[np.int64] = field(init=False)
    late: NDArray[np.int64] = field(init=False)
    newest_late: NDArray[np.bool_] = field(init=False)
    _late_by_s: list[deque[float]] = field(init=False)
    _slots: dict[int, dict[int, Arrival]] = field(default_factory=dict)
    _awaited: frozenset[int] = frozenset()
    _lock: threading.Condition = field(default_factory=threading.Condition)

    def __post_init__(self) -> None:
        self.views = np.zeros(self.num_cameras, dtype=np.int64)
        self.late = np.zeros(self.num_cameras, dtype=np.int64)
        self.newest_late = np.zeros(self.num_cameras, dtype=bool)
        self._late_by_s = [deque(maxlen=LATEST) for _ in range(self.num_cameras)]

    def add(self, slot: int, camera: int, arrival: Arrival) -> bool:
        """Add a view, replacing an older one of its slot; return whether the slot is open."""
        with self._lock:
            self.views[camera] += 1
            self.newest_late[camera] = slot < self.slot
            if slot < self.slot:
                self.late[camera] += 1
                age_ns = arrival.arrived_ns - arrival.captured_ns
                self._late_by_s[camera].append(age_ns / 1e9)
                return False
            if slot > self.slot + MAX_AHEAD_SLOTS:
                return False
            views = self._slots.setdefault(slot, {})
            views[camera] = arrival
            if slot == self.slot and self._awaited and self._awaited <= views.keys():
                self._lock.notify_all()
            return True

    def late_by_s(self, deadline_s: float) -> NDArray[np.float64]:
        """Return `(num_cameras,)`: the largest age of recent late views, seconds; NaN for none.

        Args:
            deadline_s: younger views were late for a slot that did not wait for them.
        """
        with self._lock:
            longest_s = [max(ages, default=0.0) for ages in self._late_by_s]
        return np.array([age_s if age_s >= deadline_s else np.nan for age_s in longest_s])

    def wake(self) -> None:
        """Wake up `sleep`: a camera connected or disconnected, or the program ends."""
        with self._lock:
            self._lock.notify_all()

    def missing(self, wanted: Iterable[int]) -> list[int]:
        """Return the wanted cameras that have no view in the oldest open slot."""
        with self._lock:
            here = self._slots.get(self.slot, {})
            return [camera for camera in wanted if camera not in here]

    def wait(
        self,
        clock: Clock,
        stopping: threading.Event,
        middle_ns: int,
        until_ns: Mapping[int, int],
        awaited: Callable[[Sequence[int]], Sequence[int]],
    ) -> bool:
        """Wait for the views of the oldest open slot; return False when the program ends.

        The thread is usually woken once, by the last view: in the middle of the slot there is
        nothing to do unless all views are here.

        Args:
            clock: the edge's.
            stopping: set when the program ends, with `wake`.
            middle_ns: the middle of the slot, before which it is not closed.
            until_ns: by camera whose view belongs to the slot, how long to wait for it.
            awaited: returns those of some cameras that can still send one.
        """
        while not stopping.is_set():
            now_ns = clock.now_ns()
            cameras = awaited(self.missing(c for c, end_ns in until_ns.items() if now_ns < end_ns))
            end_ns = min((until_ns[camera] for camera in cameras), default=middle_ns)
            if now_ns >= end_ns:
                return True
            self.sleep(clock, end_ns, cameras)
        return False

    def sleep(self, clock: Clock, until_ns: int, awaited: Collection[int] = ()) -> None:
        """Wait until the oldest open slot has the views of some cameras, but not past a time.

        Without such cameras no view ends the wait.
        """
        with self._lock:
            self._awaited = frozenset(awaited)
            if awaited and self._awaited <= self._slots.get(self.slot, {}).keys():
                return
            nap_ns = min(until_ns - clock.now_ns(), WAIT_NS)
            if nap_ns > 0:
                self._lock.wait(nap_ns / 1e9)

    def close(self) -> Mapping[int, Arrival]:
        """Return the views of the oldest open slot and open the next; later arrivals are late."""
        with self._lock:
            views = self._slots.pop(self.slot, {})
            self.slot += 1
            return views

    def skip_to(self, slot: int) -> None:
        """Discard all slots before `slot`."""
        with self._lock:
            self.slot = max(self.slot, slot)
            self._slots = {s: views for s, views in self._slots.items() if s >= self.slot}
