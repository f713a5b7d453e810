"""How long things take: the newest samples, and their quantiles."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

MAX_SAMPLES = 4096  # some minutes of slots


@dataclass(slots=True, eq=False)
class Durations:
    """The newest durations of one thing."""

    samples_ns: deque[int] = field(default_factory=lambda: deque(maxlen=MAX_SAMPLES))

    def add(self, duration_ns: int) -> None:
        """Take in one."""
        self.samples_ns.append(duration_ns)

    def quantiles_ms(self, *shares: float) -> tuple[float, ...]:
        """Return quantiles in milliseconds; 0 before the first sample."""
        samples = list(self.samples_ns)  # another thread may add meanwhile
        if not samples:
            return (0.0,) * len(shares)
        return tuple(float(q) for q in np.quantile(samples, shares) / 1e6)
