"""The edge's place in the network of its site: joining, sending, leaving, and joining again."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress

from e3pose.base.clock import Clock
from e3pose.base.errors import InputError
from e3pose.wire.transport import Transport

LEAVE_S = 2.0  # to leave; a network that cannot be left is no reason to hang


class Membership:
    """Owns the transport of an edge; every method may be called on any thread."""

    def __init__(
        self, transport: Transport, clock: Clock, listen: Callable[[Transport], None]
    ) -> None:
        """Take a transport; `join` uses it.

        Args:
            transport: how to reach the cameras; closed with the membership.
            clock: the edge's.
            listen: subscribes to everything and announces the edge.
        """
        self.transport = transport
        self.sending_ns: int | None = None  # since when a message has been being sent
        self._clock, self._listen = clock, listen
        self._lock = threading.Lock()

    def join(self) -> None:
        """Receive from now on, and be seen."""
        with self._lock:
            self._listen(self.transport)

    def publish(self, topic: str, payload: bytes) -> None:
        """Send a message; on one thread."""
        self.sending_ns = self._clock.now_ns()
        self.transport.publish(topic, payload)
        self.sending_ns = None

    def rejoin(self, open_transport: Callable[[], Transport]) -> None:
        """Leave the site and join it with another transport; cameras reconnect by themselves.

        Raises:
            InputError: when the network cannot be left, or not be joined.
        """
        with self._lock:
            self._leave()  # the new one listens at the same place
            self.transport = open_transport()
            self._listen(self.transport)
            self.sending_ns = None

    def leave(self) -> None:
        """Leave the site for good."""
        with self._lock, suppress(InputError):  # the program ends anyway
            self._leave()

    def _leave(self) -> None:
        """Close the transport on a thread of its own, as one that is stuck may never return."""
        leaving = threading.Thread(target=self.transport.close, name="leaving", daemon=True)
        leaving.start()
        leaving.join(LEAVE_S)
        if leaving.is_alive():
            raise InputError(f"the network was not left within {LEAVE_S:g} s")
