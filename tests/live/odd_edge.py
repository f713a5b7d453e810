"""An edge whose network hangs: `odd_edge.py SITE`. On SIGUSR1 it can send nothing any more.

The network of one that joins anew is well; `tests/edge/test_watchdog.py` has other habits.
"""

from __future__ import annotations

import signal
import sys
import threading
from typing import Any

import e3pose.wire.network as network
from e3pose.cli import main
from e3pose.wire.network import NetworkTransport

stuck: set[int] = set()  # ids of transports of before the signal
alive: list[NetworkTransport] = []


class OddTransport(NetworkTransport):
    """Well until it is stuck."""

    def __init__(self, session: Any) -> None:
        super().__init__(session)
        alive.append(self)

    def publish(self, topic: str, payload: bytes) -> None:
        if id(self) in stuck:
            threading.Event().wait()
        super().publish(topic, payload)


network.NetworkTransport = OddTransport  # type: ignore[misc, assignment]
signal.signal(signal.SIGUSR1, lambda *_: stuck.update(map(id, alive)))
main(["edge", *sys.argv[1:], "--json-logs"])
