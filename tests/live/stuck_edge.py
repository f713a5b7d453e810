"""An edge whose network gets stuck on SIGUSR1: `stuck_edge.py FAULT SITE`.

What it joins afterwards is well. FAULT is `blocked` (publishing hangs) or `all-lost` (nothing of
cameras arrives); `tests/edge/test_stall.py` has the others.
"""

from __future__ import annotations

import signal
import sys
import threading
from typing import Any

import e3pose.wire.network as network
from e3pose.cli import main
from e3pose.wire.network import NetworkTransport

FAULT = sys.argv[1]
stuck: set[int] = set()  # ids of the transports of before the signal
alive: list[NetworkTransport] = []


class FaultyTransport(NetworkTransport):
    """Well until it is stuck."""

    def __init__(self, session: Any) -> None:
        super().__init__(session)
        alive.append(self)

    def publish(self, topic: str, payload: bytes) -> None:
        if id(self) in stuck and FAULT == "blocked":
            threading.Event().wait()
        super().publish(topic, payload)

    def subscribe(self, topic: str, receive: Any) -> None:
        def take(found: str, payload: bytes) -> None:
            if FAULT != "all-lost" or id(self) not in stuck:
                receive(found, payload)

        super().subscribe(topic, take)

    def answer(self, topic: str, answer: Any) -> None:
        def reply(found: str, payload: bytes) -> bytes | None:
            if FAULT == "all-lost" and id(self) in stuck:
                return None
            return answer(found, payload)  # type: ignore[no-any-return]

        super().answer(topic, reply)


def get_stuck(*_: object) -> None:
    stuck.update(map(id, alive))


network.NetworkTransport = FaultyTransport  # type: ignore[misc, assignment]
signal.signal(signal.SIGUSR1, get_stuck)
main(["edge", *sys.argv[2:], "--json-logs"])
