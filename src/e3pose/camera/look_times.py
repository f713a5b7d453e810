"""Processor time of looks and frames, as a video is read and its people are detected."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from e3pose.energy.saving import LEAST
from e3pose.recording import ProcessorTime


class LookTimes:
    """Adds up what the program takes for one camera, all its threads together."""

    def __init__(self) -> None:
        """Begin."""
        self._awake_s = self._look_s = 0.0
        self._looks = 0

    @contextmanager
    def awake(self) -> Iterator[None]:
        """Count the body, with the looks in it, as work for the camera."""
        before_s = time.process_time()
        yield
        self._awake_s += time.process_time() - before_s

    @contextmanager
    def look(self) -> Iterator[None]:
        """Count the body as a look."""
        before_s = time.process_time()
        yield
        self.add(time.process_time() - before_s)

    def add(self, look_s: float) -> None:
        """Count a look that took so many seconds of the processor."""
        self._look_s += look_s
        self._looks += 1

    def found(self) -> ProcessorTime | None:
        """Return the times so far; None after too few looks."""
        if self._looks < LEAST:
            return None
        rest_s = max(self._awake_s - self._look_s, 0.0)
        return ProcessorTime(self._look_s / self._looks, rest_s / self._looks, self._looks)


def taken(times: Mapping[str, LookTimes]) -> dict[str, ProcessorTime]:
    """Return the processor times of cameras with enough looks."""
    found = {camera_id: each.found() for camera_id, each in times.items()}
    return {camera_id: took for camera_id, took in found.items() if took is not None}
