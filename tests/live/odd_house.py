"""An edge of several sites: `odd_house.py SITE...`. On SIGUSR1 the next slot of `hall` raises."""

from __future__ import annotations

import signal
import sys
import threading
from typing import Any

import e3pose.edge.server as server
from e3pose.cli import main

poisoned = threading.Event()
at_work = threading.local()  # the site of each thread
usual_compute, usual_step = server.EdgeServer._compute, server.step  # type: ignore[attr-defined]


def compute(edge: server.EdgeServer, *about: Any) -> None:
    at_work.site = edge.settings.site
    usual_compute(edge, *about)


def step(*about: Any) -> Any:
    if at_work.site == "hall" and poisoned.is_set():
        poisoned.clear()
        raise KeyError("poisoned")
    return usual_step(*about)


server.EdgeServer._compute = compute  # type: ignore[method-assign, assignment]
server.step = step  # type: ignore[attr-defined, assignment]
signal.signal(signal.SIGUSR1, lambda *_: poisoned.set())
main(["edge", *sys.argv[1:], "--json-logs"])
