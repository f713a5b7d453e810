"""Wait for other threads and programs, and look at these."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress

import psutil

WAIT_S = 30.0  # for what takes a second or two on a machine that does nothing else


def eventually(condition: Callable[[], object], seconds: float = WAIT_S) -> bool:
    """Return whether a condition comes to hold in time.

    It holds from the moment it is first seen to: what holds now may not a moment later. The longer
    it takes, the more rarely one looks, which costs a browser or a store as much as its work.
    """
    begun_s = time.monotonic()
    while not condition():
        waited_s = time.monotonic() - begun_s
        if waited_s >= seconds:
            return False
        time.sleep(min(max(0.05 * waited_s, 0.02), 0.1))
    return True


def settled(count: Callable[[], int], for_s: float = 0.25, seconds: float = WAIT_S) -> int:
    """Return a count once it has stayed the same for a while, or the last one after `seconds`.

    For what must not go on: a machine that was busy meanwhile can hide that it does, but can not
    make a test fail.
    """
    end_s = time.monotonic() + seconds
    last, since_s = count(), time.monotonic()
    while time.monotonic() < min(since_s + for_s, end_s):
        time.sleep(0.02)
        now = count()
        if now != last:
            last, since_s = now, time.monotonic()
    return last


def commands_below(process: psutil.Process) -> dict[psutil.Process, list[str]]:
    """Return the command lines of all programs below one; not of those that have just ended."""
    found: dict[psutil.Process, list[str]] = {}
    for child in process.children(recursive=True):
        with suppress(psutil.NoSuchProcess):
            found[child] = child.cmdline()
    return found
