"""A transport inside one process, for tests, with the faults of a network on demand."""

from __future__ import annotations

import heapq
import itertools
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from e3pose.wire.transport import Answer, Presence, Receive

Fault = Callable[[str, bytes], bytes | None]  # what arrives instead; None when it is lost
Delay = Callable[[str], float]  # seconds, by topic


def _at_once(topic: str) -> float:
    return 0.0


def _pass(topic: str, payload: bytes) -> bytes | None:
    return payload


@dataclass(eq=False)
class Hub:
    """The air between the transports of one process.

    Attributes:
        fault: what happens to everything that is sent.
        delay_s: how long it takes to arrive.
        speed: of the site's clock, in whose seconds delays are.
    """

    fault: Fault = _pass
    delay_s: Delay = _at_once
    speed: float = 1.0
    members: list[MemoryTransport] = field(default_factory=list)
    lock: threading.RLock = field(default_factory=threading.RLock)
    air: Air = field(default_factory=lambda: Air())

    def way_s(self, topic: str) -> float:
        """Return how long a message takes by the clock on the wall."""
        return self.delay_s(topic) / self.speed

    def join(self) -> MemoryTransport:
        """Return a transport of its own for one program."""
        member = MemoryTransport(self)
        with self.lock:
            self.members.append(member)
        return member


@dataclass(eq=False)
class MemoryTransport:
    """One program's end of a `Hub`; see `Transport`. Receivers run on the sender's thread."""

    hub: Hub
    receivers: list[tuple[str, Receive]] = field(default_factory=list)
    answers: list[tuple[str, Answer]] = field(default_factory=list)
    watchers: list[tuple[str, Presence]] = field(default_factory=list)
    present: list[str] = field(default_factory=list)

    def publish(self, topic: str, payload: bytes) -> None:
        """See `Transport.publish`."""
        arrived = self.hub.fault(topic, payload)
        if arrived is None or self not in self.hub.members:
            return
        self.hub.air.carry(self.hub.way_s(topic), lambda: self._deliver(topic, arrived))

    def _deliver(self, topic: str, arrived: bytes) -> None:
        for member in list(self.hub.members):
            for pattern, receive in list(member.receivers):
                if matches(pattern, topic):
                    receive(topic, arrived)

    def subscribe(self, topic: str, receive: Receive) -> None:
        """See `Transport.subscribe`."""
        self.receivers.append((topic, receive))

    def ask(self, topic: str, payload: bytes, timeout_s: float) -> bytes | None:
        """See `Transport.ask`."""
        arrived = self.hub.fault(topic, payload)
        begun_s, way_s = time.monotonic(), self.hub.way_s(topic)
        time.sleep(min(way_s, timeout_s))
        for member in list(self.hub.members):
            for pattern, answer in member.answers:
                if arrived is not None and matches(pattern, topic):
                    reply = answer(topic, arrived)
                    back_s = self.hub.way_s(topic)
                    left_s = timeout_s - (time.monotonic() - begun_s)
                    time.sleep(max(min(back_s, left_s), 0.0))
                    lost = reply is None or back_s > left_s
                    return None if lost or reply is None else self.hub.fault(topic, reply)
        return None

    def answer(self, topic: str, answer: Answer) -> None:
        """See `Transport.answer`."""
        self.answers.append((topic, answer))

    def be_present(self, topic: str) -> None:
        """See `Transport.be_present`."""
        self.present.append(topic)
        self._tell(topic, True)

    def watch(self, topic: str, presence: Presence) -> None:
        """See `Transport.watch`."""
        self.watchers.append((topic, presence))
        for member in list(self.hub.members):
            for found in member.present:
                if matches(topic, found):
                    presence(found, True)

    def connected(self) -> bool:
        """See `Transport.connected`."""
        return self in self.hub.members and len(self.hub.members) > 1

    def close(self) -> None:
        """See `Transport.close`."""
        with self.hub.lock:
            if self not in self.hub.members:
                return
            self.hub.members.remove(self)
        gone, self.present = self.present, []
        for topic in gone:
            self._tell(topic, False)

    def _tell(self, topic: str, there: bool) -> None:
        for member in list(self.hub.members):
            for pattern, presence in list(member.watchers):
                if matches(pattern, topic):
                    presence(topic, there)


@dataclass(eq=False)
class Air:
    """Carries what is under way, on a thread that ends when nothing is."""

    _under_way: list[tuple[float, int, Callable[[], None]]] = field(default_factory=list)
    _count: itertools.count[int] = field(default_factory=itertools.count)
    _change: threading.Condition = field(default_factory=threading.Condition)
    _busy: bool = False

    def carry(self, seconds: float, deliver: Callable[[], None]) -> None:
        """Deliver after a time; at once, on this thread, after none."""
        if seconds <= 0:
            deliver()
            return
        with self._change:
            due_s = time.monotonic() + seconds
            heapq.heappush(self._under_way, (due_s, next(self._count), deliver))
            self._change.notify()
            if not self._busy:
                self._busy = True
                threading.Thread(target=self._run, name="air", daemon=True).start()

    def _run(self) -> None:
        while True:
            with self._change:
                if not self._under_way:
                    self._busy = False
                    return
                left_s = self._under_way[0][0] - time.monotonic()
                if left_s > 0:
                    self._change.wait(left_s)
                    continue
                deliver = heapq.heappop(self._under_way)[2]
            deliver()


def matches(pattern: str, topic: str) -> bool:
    """Return whether a topic is one of those that a pattern with `*` names."""
    wanted, found = pattern.split("/"), topic.split("/")
    return len(wanted) == len(found) and all(
        w in ("*", f) for w, f in zip(wanted, found, strict=True)
    )
