"""The Protocol of a transport."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

Receive = Callable[[str, bytes], None]  # topic, payload
Answer = Callable[[str, bytes], bytes | None]  # topic, payload -> payload
Presence = Callable[[str, bool], None]  # topic, whether somebody is there


class Transport(Protocol):
    """Carry bytes between the programs of a site.

    Receivers are called on threads of the transport, one call at a time for each of them; they
    must be quick, and must not raise.
    """

    def publish(self, topic: str, payload: bytes) -> None:
        """Send to all subscribers; what cannot be sent now is dropped, never queued for long."""
        ...

    def subscribe(self, topic: str, receive: Receive) -> None:
        """Receive messages on a topic, in which `*` stands for any one part."""
        ...

    def ask(self, topic: str, payload: bytes, timeout_s: float) -> bytes | None:
        """Return an answer to a request on a topic; None if none arrived in time."""
        ...

    def answer(self, topic: str, answer: Answer) -> None:
        """Answer questions on a topic, in which `*` stands for any one part."""
        ...

    def be_present(self, topic: str) -> None:
        """Announce presence to watchers of the topic, until closed, killed or disconnected."""
        ...

    def watch(self, topic: str, presence: Presence) -> None:
        """Call back for every program present now, that connects, or that disconnects."""
        ...

    def connected(self) -> bool:
        """Return whether any connection stands, whatever the other side admits."""
        ...

    def close(self) -> None:
        """Leave; nothing is received afterwards."""
        ...
