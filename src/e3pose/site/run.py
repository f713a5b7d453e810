"""Run a program until Ctrl-C or SIGTERM, for months without pauses, and end it cleanly."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from e3pose.base.errors import Exit, Fault
from e3pose.base.system import END_SIGNALS

END_S = 8.0  # to end cleanly
SAME_S = 1.0  # a terminal, `timeout` or a parent may send one signal twice
SWITCH_S = 5e-4  # a thread that a message woke waits this long for one that computes, not 5 ms
HEAPS = 2
_M_ARENA_MAX = -8  # in malloc.h of the GNU C library


def end_with_parent(end_s: float = END_S) -> None:
    """End this program as a polite kill would when its standard input ends.

    To be called by a program whose input is a pipe that nobody writes to. The system closes the
    other end when whoever holds it is gone, however that came about: the one death that nobody
    can report, SIGKILL, is noticed at once and on every system.

    Args:
        end_s: seconds after which a program that did not end is ended without more ado.
    """

    def watch() -> None:
        number = 0 if sys.stdin is None else sys.stdin.fileno()
        try:
            while os.read(number, 4096):
                pass
        except OSError:
            pass  # there is no input, and so nobody
        signal.raise_signal(signal.SIGTERM)  # the handler runs on the main thread
        threading.Event().wait(end_s)
        os._exit(Exit.SIGNAL + signal.SIGTERM)

    threading.Thread(target=watch, name="parent", daemon=True).start()


def run_until_stopped(
    running: Callable[[], bool], for_s: float | None = None, every_s: float = 0.2
) -> str:
    """Wait until SIGINT, SIGTERM, the time is over or the program ends by itself; return which.

    While it then ends cleanly, the same signal sent twice at once is one, and another one a second
    later ends it without more ado.

    Args:
        running: whether the program still works.
        for_s: seconds after which it is to end; None for without end.
        every_s: seconds between two calls of `running`.

    Raises:
        Fault: for what `running` raises.
    """
    stop, begun_s = threading.Event(), time.monotonic()
    signals: list[tuple[str, float]] = []

    def end(number: int, _frame: Any) -> None:
        signals.append((signal.Signals(number).name, time.monotonic()))
        stop.set()
        if signals[-1][1] - signals[0][1] > SAME_S:
            os._exit(Exit.SIGNAL + number)

    before = {number: signal.signal(number, end) for number in END_SIGNALS}
    try:
        while running() and (for_s is None or time.monotonic() - begun_s < for_s):
            if stop.wait(every_s):
                break
    except Exception as error:  # the program had started
        raise Fault(str(error)) from error
    finally:
        if not signals:  # else it ends, and an exception from a second signal would leave threads
            for number, handler in before.items():
                signal.signal(number, handler)
    return signals[0][0] if signals else "ended"


def bound_heaps() -> None:
    """Have all threads share two heaps of the C library; to be called before there are threads.

    It gives each new thread one of eight heaps for each core. Threads that check the store or
    answer a viewer live for a moment, and what their heaps keep grew by 80 MB in an hour.
    """
    with suppress(AttributeError, OSError):  # of another C library, which has no such heaps
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, HEAPS)


def reduce_pauses() -> None:
    """Switch threads sooner, and collect garbage as usual, but for what is there already.

    To be called once everything is loaded. What is there then, some hundred thousand objects of
    compilers and libraries, takes half a second to look through, and none of it will ever go.
    """
    sys.setswitchinterval(SWITCH_S)
    gc.collect()
    gc.freeze()
    gc.set_threshold(700)  # `main` collects less often while programs load
