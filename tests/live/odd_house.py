"""An edge of several sites, some of which fail: `odd_house.py SITE...`.

On SIGUSR1 the next slot of the site `hall` raises. From SIGUSR2 on each of its slots computes for
longer than it lasts, without letting go of the interpreter.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from typing import Any

import e3pose.edge.server as server
from e3pose.cli import main

SLOT_S = 0.08
poisoned, is_slow = threading.Event(), threading.Event()
at_work = threading.local()  # the site of each thread
usual_compute, usual_step = server.EdgeServer._compute, server.step  # type: ignore[attr-defined]


def compute(edge: server.EdgeServer, *about: Any) -> None:
    at_work.site = edge.settings.site
    usual_compute(edge, *about)


def step(*about: Any) -> Any:
    if at_work.site == "hall" and poisoned.is_set():
        poisoned.clear()
        raise KeyError("poisoned")
    if at_work.site == "hall" and is_slow.is_set():
        end_s = time.thread_time() + SLOT_S
        while time.thread_time() < end_s:
            sum(range(1000))
    return usual_step(*about)


server.EdgeServer._compute = compute  # type: ignore[method-assign, assignment]
server.step = step  # type: ignore[attr-defined, assignment]
signal.signal(signal.SIGUSR1, lambda *_: poisoned.set())
signal.signal(signal.SIGUSR2, lambda *_: is_slow.set())
main(["edge", *sys.argv[1:], "--json-logs"])
