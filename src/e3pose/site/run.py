"""Run a program until it is told to end: Ctrl-C and a polite kill end it cleanly and quickly."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from typing import Any


def run_until_stopped(running: Callable[[], bool], every_s: float = 0.2) -> str:
    """Wait until SIGINT, SIGTERM, or the program ends by itself; return which.

    Args:
        running: whether the program still works.
        every_s: how often to look.
    """
    stop = threading.Event()
    told: list[str] = []

    def end(number: int, _frame: Any) -> None:
        told.append(signal.Signals(number).name)
        stop.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        while running() and not stop.wait(every_s):
            pass
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return told[0] if told else "ended"
