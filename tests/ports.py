"""Ports of loopback for sites of tests, which no two processes of tests take from each other."""

from __future__ import annotations

import fcntl
import functools
import itertools
import os
import socket
import tempfile
from pathlib import Path

# Below the ports that a system gives to outgoing connections, of which every program takes some.
FIRST, LAST = 20_000, 32_000

_PORTS = itertools.cycle(FIRST + (os.getpid() + i) % (LAST - FIRST) for i in range(LAST - FIRST))


@functools.cache
def _given() -> int:
    """Return a descriptor that holds the locks of this process, until the process has ended."""
    path = Path(tempfile.gettempdir()) / f"test-ports-{os.getuid()}"
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)


def free_port() -> int:
    """Return a port that nobody listens on and that no process of tests has been given."""
    for port in itertools.islice(_PORTS, LAST - FIRST):
        try:  # other workers and other runs lock a byte for each of their ports, while they live
            fcntl.lockf(_given(), fcntl.LOCK_EX | fcntl.LOCK_NB, 1, port)
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
