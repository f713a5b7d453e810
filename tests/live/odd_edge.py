"""An edge with habits: `odd_edge.py SITE`. On SIGUSR1 it takes the one that the file `habit` names.

`slow` computes too long for each view, and receives nothing meanwhile, as an interpreter that
computes. The network of one that is `blocked` (publishing hangs) or `lost` (nothing of cameras
arrives) is well once it is joined anew; `tests/edge/test_watchdog.py` has others. `well` has none.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

import e3pose.edge.overload as overload
import e3pose.edge.server as server
import e3pose.wire.network as network
from e3pose.cli import main
from e3pose.wire.network import NetworkTransport

VIEW_S = 0.08  # two views take longer than three slots
CALM_S = 4.0  # of low load, in place of 20 s
HABIT = Path(sys.argv[1]).parent / "habit"
usual_step = server.step  # type: ignore[attr-defined]
is_slow, busy = threading.Event(), threading.Lock()
stuck: dict[int, str] = {}  # how, by the id of a transport of before the signal
alive: list[NetworkTransport] = []


def step(pipeline: Any, state: Any, views: Any, *more: Any) -> Any:
    if is_slow.is_set():
        with busy:
            time.sleep(VIEW_S * len(views))
    return usual_step(pipeline, state, views, *more)


class OddTransport(NetworkTransport):
    """Well until it is stuck."""

    def __init__(self, session: Any) -> None:
        super().__init__(session)
        alive.append(self)

    def publish(self, topic: str, payload: bytes) -> None:
        if stuck.get(id(self)) == "blocked":
            threading.Event().wait()
        super().publish(topic, payload)

    def subscribe(self, topic: str, receive: Any) -> None:
        def take(found: str, payload: bytes) -> None:
            if stuck.get(id(self)) == "lost":
                return
            if is_slow.is_set():
                with busy:
                    pass
            receive(found, payload)

        super().subscribe(topic, take)

    def answer(self, topic: str, answer: Any) -> None:
        def reply(found: str, payload: bytes) -> bytes | None:
            if stuck.get(id(self)) == "lost":
                return None
            return answer(found, payload)  # type: ignore[no-any-return]

        super().answer(topic, reply)


def take_habit(*_: object) -> None:
    habit = HABIT.read_text()
    if habit in ("blocked", "lost"):
        stuck.update({id(one): habit for one in alive})
    elif habit == "slow":
        is_slow.set()
    else:
        is_slow.clear()


server.step = step  # type: ignore[attr-defined, assignment]
network.NetworkTransport = OddTransport  # type: ignore[misc, assignment]
overload.CALM_S = CALM_S
signal.signal(signal.SIGUSR1, take_habit)
main(["edge", *sys.argv[1:], "--json-logs"])
