"""An edge of a site with a habit: `odd_edge.py HABIT SITE`.

`slow` computes too long for each view from SIGUSR1 until SIGUSR2, and receives nothing meanwhile,
as an interpreter that computes. `eager` makes its status, looks after its cameras, and reports
events as often as it can, with threads that change all the time.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from typing import Any

import e3pose.edge.housekeeping as housekeeping
import e3pose.edge.server as server
from e3pose.cli import main
from e3pose.wire.network import NetworkTransport

VIEW_S = 0.08  # two views take longer than three slots
SWITCH_S = 1e-5
LOOK_S = 1e-3
CHATTER = "chatter"  # a kind of events that no log needs


class Chatter:
    """An event of which other threads can run while it is read."""

    kind, time_ns = CHATTER, 0

    @property
    def message(self) -> str:
        time.sleep(0)
        return CHATTER


def slow() -> None:
    usual_step = server.step  # type: ignore[attr-defined]
    is_slow, busy = threading.Event(), threading.Lock()
    usual_subscribe = NetworkTransport.subscribe

    def slow_step(pipeline: Any, state: Any, views: Any, *more: Any) -> Any:
        if is_slow.is_set():
            with busy:
                time.sleep(VIEW_S * len(views))
        return usual_step(pipeline, state, views, *more)

    def subscribe(transport: NetworkTransport, topic: str, receive: Any) -> None:
        def take(found: str, payload: bytes) -> None:
            with busy:
                receive(found, payload)

        usual_subscribe(transport, topic, take)

    server.step = slow_step  # type: ignore[attr-defined, assignment]
    NetworkTransport.subscribe = subscribe  # type: ignore[method-assign, assignment]
    signal.signal(signal.SIGUSR1, lambda *_: is_slow.set())
    signal.signal(signal.SIGUSR2, lambda *_: is_slow.clear())


def eager() -> None:
    sys.setswitchinterval(SWITCH_S)
    housekeeping.KEEPING_S, housekeeping.LOOK_S = 0.0, LOOK_S
    usual_start = server.EdgeServer.start

    def start(edge: server.EdgeServer) -> None:
        log, stopping = edge.event_log, edge.threads.stopping
        shown = log._shown

        def chatter() -> None:
            while not stopping.is_set():
                log.add(Chatter())  # type: ignore[arg-type]
                time.sleep(0)

        log._shown = lambda event: None if event.kind == CHATTER else shown(event)
        usual_start(edge)
        edge.threads.start(CHATTER, chatter)

    server.EdgeServer.start = start  # type: ignore[method-assign, assignment]


{"slow": slow, "eager": eager}[sys.argv[1]]()
main(["edge", *sys.argv[2:], "--json-logs"])
