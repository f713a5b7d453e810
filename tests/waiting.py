"""Wait for what other threads and programs do."""

from __future__ import annotations

import time
from collections.abc import Callable

WAIT_S = 30.0  # for what takes a second or two on a machine that does nothing else


def eventually(condition: Callable[[], object], seconds: float = WAIT_S) -> bool:
    """Return whether a condition comes to hold in time.

    It holds from the moment it is first seen to: what holds now may not a moment later.
    """
    end_s = time.monotonic() + seconds
    while not condition():
        if time.monotonic() >= end_s:
            return False
        time.sleep(0.02)
    return True
