"""Which cameras answer: one that is ordered again and again and sends nothing is presumed dead."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Flags = NDArray[np.bool_]

MISSES = 5  # in a row: at 30 % lost messages one in 400 such rows is mere bad luck
RETRY_S = 1.0  # a camera presumed dead may be ordered again after this; doubled at each failure
RETRY_LIMIT_S = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class Silence:
    """How long cameras have not answered.

    Attributes:
        missed: `(num_cameras,)` orders in a row that no view came for.
        retry_slot: `(num_cameras,)` the first slot for which a camera may be ordered again.
    """

    missed: NDArray[np.int64]
    retry_slot: NDArray[np.int64]

    @classmethod
    def none(cls, num_cameras: int) -> Silence:
        """Return the state before the first slot: everybody is presumed well."""
        return cls(np.zeros(num_cameras, dtype=np.int64), np.zeros(num_cameras, dtype=np.int64))

    def answering(self, slot: int) -> Flags:
        """Return `(num_cameras,)`: who may be ordered for `slot`."""
        return np.asarray(self.retry_slot <= slot)


def listen(
    silence: Silence, slot: int, ordered: Flags, arrived: Flags, interval_s: float
) -> Silence:
    """Return what is known after `slot`, in which cameras `ordered` to detect did or did not."""
    missed = np.where(arrived, 0, silence.missed + ordered)
    late = np.minimum(np.maximum(missed - MISSES, 0), 10)
    wait_s = np.minimum(RETRY_S * 2.0**late, RETRY_LIMIT_S)
    again = slot + np.ceil(wait_s / interval_s).astype(np.int64)
    retry = np.where(ordered & (missed >= MISSES), again, silence.retry_slot)
    return Silence(missed, np.where(arrived, 0, retry))
