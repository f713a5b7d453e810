"""The send queue: the newest message of each topic and slot, bounded."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

MAX_WAITING = 4096


@dataclass(slots=True, eq=False)
class SendQueue:
    """Messages by topic and slot, where newer ones replace older ones; thread-safe."""

    _waiting: dict[tuple[str, int], bytes] = field(default_factory=dict)
    _change: threading.Condition = field(default_factory=threading.Condition)
    _closed: bool = False
    _runs: int = 0

    def put(self, topic: str, payload: bytes, slot: int = -1) -> None:
        """Queue a message; it replaces one of the same topic and slot."""
        self.put_all({topic: payload}, slot)

    def put_all(self, payloads: Mapping[str, bytes], slot: int = -1) -> None:
        """Queue a message for each topic, and wake the sending thread once."""
        with self._change:
            for topic, payload in payloads.items():
                self._waiting.pop((topic, slot), None)
                if len(self._waiting) >= MAX_WAITING:
                    self._waiting.pop(next(iter(self._waiting)))
                self._waiting[topic, slot] = payload
            self._change.notify()

    def close(self) -> None:
        """Send the queued messages, then end."""
        with self._change:
            self._closed = True
            self._change.notify()

    def run(self, publish: Callable[[str, bytes, int], None]) -> None:
        """Send until closed; the body of the sending thread. `publish` also gets the slot.

        A later call takes over and drops what has waited meanwhile: one whose `publish` hangs
        ends when that returns.
        """
        with self._change:
            self._runs += 1
            run = self._runs
            if run > 1:
                self._waiting = {}
        while True:
            with self._change:
                while not self._waiting and not self._closed and run == self._runs:
                    self._change.wait()
                if not self._waiting or run != self._runs:
                    return
            self.send_waiting(publish)

    def send_waiting(self, publish: Callable[[str, bytes, int], None]) -> None:
        """Send the queued messages, unless a later call of `run` takes over."""
        with self._change:
            batch, self._waiting, run = self._waiting, {}, self._runs
        for (topic, slot), payload in batch.items():
            if run != self._runs:
                return
            publish(topic, payload, slot)
