"""Processor time of a camera program: measured on every machine, without a power sensor."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class ProcessorTime:
    """Seconds of all threads since the camera began to capture, and what part of them looking took.

    What the capture thread takes while the network runs belongs to capturing.
    """

    def __init__(self) -> None:
        """Begin."""
        self._begun_ns = time.process_time_ns()
        self._look_ns = self._capture_ns = 0

    @property
    def total_s(self) -> float:
        """Seconds so far."""
        return (time.process_time_ns() - self._begun_ns) / 1e9

    @property
    def look_s(self) -> float:
        """Seconds that looking took so far."""
        return self._look_ns / 1e9

    def capturing(self) -> None:
        """Note what the capture thread took so far; call it on that thread."""
        self._capture_ns = time.thread_time_ns()

    @contextmanager
    def looking(self) -> Iterator[None]:
        """Count what the program takes meanwhile as looking, but for the capture thread."""
        begun_ns, capture_ns = time.process_time_ns(), self._capture_ns
        try:
            yield
        finally:
            took_ns = time.process_time_ns() - begun_ns - (self._capture_ns - capture_ns)
            self._look_ns += max(took_ns, 0)
