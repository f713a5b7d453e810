"""The rate at which a source really brings frames, from the times at which they came.

What a stream or device announces is its nominal rate. Network cameras bring fewer frames in the
dark or to several viewers, and a stream of single images announces 25 whatever it brings.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

NEWEST = 31  # frames that a running rate is measured from
LEAST = 11  # frames, before which the nominal rate is taken
PAUSE_NS = 1_000_000_000  # without a frame: a source that was closed, or lost its connection
MEASURING_ERROR = 0.03  # of a rate from three seconds: a nominal rate so near is the rate


def rate_hz(times_ns: Sequence[int]) -> float | None:
    """Return frames per second; None of fewer than two frames, or of one moment.

    Args:
        times_ns: when frames were taken, rising.
    """
    if len(times_ns) < 2 or times_ns[-1] <= times_ns[0]:
        return None
    return (len(times_ns) - 1) * 1e9 / (times_ns[-1] - times_ns[0])


def rounded_hz(measured_hz: float | None, nominal_hz: float) -> float:
    """Return the rate to say and to set: the nominal one if no other was measured."""
    if measured_hz is None or abs(measured_hz / nominal_hz - 1) <= MEASURING_ERROR:
        return nominal_hz
    return float(f"{measured_hz:.3g}")


@dataclass(slots=True, eq=False)
class FrameRate:
    """The rate of the newest frames of a running source."""

    _times_ns: deque[int] = field(default_factory=lambda: deque(maxlen=NEWEST))

    def add(self, taken_ns: int) -> None:
        """Add a frame by the time at which it was taken."""
        times_ns = self._times_ns
        if times_ns and not 0 <= taken_ns - times_ns[-1] < PAUSE_NS:
            times_ns.clear()
        times_ns.append(taken_ns)

    def hz(self, nominal_hz: float) -> float:
        """Return the rate of the newest frames; the nominal one while they are too few."""
        if len(self._times_ns) < LEAST:
            return nominal_hz
        return rate_hz(self._times_ns) or nominal_hz
