"""Ports of loopback for sites of tests, which workers of pytest do not take from each other."""

from __future__ import annotations

import itertools
import os
import socket
from collections.abc import Iterator

# Below the ports that a system gives to outgoing connections, of which every program takes some.
FIRST, LAST = 20_000, 32_000
SHARE = 1000  # of each worker


def _candidates() -> Iterator[int]:
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    begin = FIRST + worker * SHARE % (LAST - FIRST)
    # Two runs at a time begin at different places.
    return itertools.cycle(begin + (os.getpid() + i) % SHARE for i in range(SHARE))


_PORTS = _candidates()


def free_port() -> int:
    """Return a port that nobody listens on and that this process has not given for long."""
    for port in itertools.islice(_PORTS, SHARE):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise OSError(f"found no free port of {SHARE}")
