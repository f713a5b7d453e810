"""Processor time of a site's cameras, from their heartbeats during a recording.

A recording has a frame a slot. A camera may capture more of them, and capture goes on in slots in
which it does not look: what is not looking is divided by the slots in which it was awake.
"""

from __future__ import annotations

import threading
from collections import defaultdict
from dataclasses import dataclass

from e3pose.energy.saving import LEAST
from e3pose.recording import ProcessorTime
from e3pose.wire.messages import Heartbeat


@dataclass(slots=True)
class _Spent:
    look_s: float = 0.0
    other_s: float = 0.0
    awake_s: float = 0.0
    looks: int = 0


class ProcessorTimes:
    """Adds up processor time between heartbeats of each program; thread-safe."""

    def __init__(self, slots_per_s: float) -> None:
        """Begin.

        Args:
            slots_per_s: slots that pass in a second, however slowly a scene is played.
        """
        self._slots_per_s, self._lock = slots_per_s, threading.Lock()
        self._last: dict[str, Heartbeat] = {}
        self._spent: dict[str, _Spent] = defaultdict(_Spent)

    def take(self, beat: Heartbeat) -> None:
        """Take in a heartbeat."""
        with self._lock:
            before, self._last[beat.camera_id] = self._last.get(beat.camera_id), beat
            if before is None or before.session != beat.session:
                return
            if before.cpu_s is None or beat.cpu_s is None or beat.cpu_s < before.cpu_s:
                return
            spent, look_s = self._spent[beat.camera_id], beat.look_cpu_s - before.look_cpu_s
            spent.look_s += look_s
            spent.other_s += max(beat.cpu_s - before.cpu_s - look_s, 0.0)
            spent.awake_s += beat.active_s + beat.idle_s - before.active_s - before.idle_s
            spent.looks += beat.detected - before.detected

    def found(self) -> dict[str, ProcessorTime]:
        """Return times of looks and frames since the last call, for cameras with enough looks."""
        with self._lock:
            spent, self._spent = self._spent, defaultdict(_Spent)
        return {
            camera_id: ProcessorTime(
                each.look_s / each.looks,
                each.other_s / (each.awake_s * self._slots_per_s),
                each.looks,
            )
            for camera_id, each in spent.items()
            if each.looks >= LEAST and each.awake_s > 0
        }
