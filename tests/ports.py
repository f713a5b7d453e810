"""Ports of loopback for sites of tests, which no two processes of tests take from each other."""

from __future__ import annotations

import fcntl
import itertools
import os
import socket
import tempfile
from pathlib import Path
from typing import BinaryIO

# Below the ports that a system gives to outgoing connections, of which every program takes some.
FIRST, LAST = 20_000, 32_000

_PORTS = itertools.cycle(FIRST + (os.getpid() + i) % (LAST - FIRST) for i in range(LAST - FIRST))
_given: list[BinaryIO] = []  # holds the locks of this process


def free_port() -> int:
    """Return a port that nobody listens on and that no process of tests has been given."""
    if not _given:
        _given.append((Path(tempfile.gettempdir()) / f"test-ports-{os.getuid()}").open("ab"))
    for port in itertools.islice(_PORTS, LAST - FIRST):
        try:  # other workers and other runs lock a byte for each of their ports, while they live
            fcntl.lockf(_given[0], fcntl.LOCK_EX | fcntl.LOCK_NB, 1, port)
        except OSError:
            continue
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise OSError(f"found no free port from {FIRST} to {LAST}")
