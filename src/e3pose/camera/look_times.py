"""Processor time of looks and frames, as a video is read and its people are detected."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from e3pose.energy.processor_time import LEAST
from e3pose.recording import ProcessorTime


class LookTimes:
    """Adds up what the program takes, all its threads together, from when this is made."""

    def __init__(self) -> None:
        """Begin."""
        self._began_s, self._look_s, self._looks = time.process_time(), 0.0, 0

    @contextmanager
    def look(self) -> Iterator[None]:
        """Count the body as a look."""
        before_s = time.process_time()
        yield
        self._look_s += time.process_time() - before_s
        self._looks += 1

    def found(self) -> ProcessorTime | None:
        """Return the times so far; None after too few looks."""
        if self._looks < LEAST:
            return None
        rest_s = max(time.process_time() - self._began_s - self._look_s, 0.0)
        return ProcessorTime(self._look_s / self._looks, rest_s / self._looks, self._looks)
