"""Fan out an edge's messages to HTTP clients; the newest wins."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field

from e3pose.site.connect import LiveSlot, live_slot
from e3pose.site.follow import Follower
from e3pose.site.web.schemas import (
    Encoded,
    event_of_edge,
    event_of_slot,
    event_of_status,
    event_of_zone,
)
from e3pose.site.zones import Zones, advance
from e3pose.wire.site_messages import Poses, Status
from e3pose.wire.transport import Transport

MAX_WAITING = 32  # messages that a slow follower has not taken yet
MAX_FOLLOWERS, MAX_OF_ADDRESS = 64, 16
MAX_RECENT = 100
QUIET_S = 3.0  # without a word of the edge, which says something every second
WATCH_S = 0.25


class TooMany(Exception):
    """There are as many followers as the server takes, in all or from one address."""


@dataclass(eq=False)
class Feed:
    """The newest messages of a site, and a queue for each follower.

    Attributes:
        site: its name.
        slot: the newest; None before the first.
        status: likewise.
        zones: who is in which.
        recent: the newest slots by number, for pictures, which come later.
        heard_ns: when the edge was last heard, nanoseconds since 1970; None before the first time.
        now_s: a clock that only goes forward.
        quiet_s: without a word of the edge, until it is told to be gone.
    """

    site: str
    slot: LiveSlot | None = None
    status: Status | None = None
    zones: Zones = field(default_factory=lambda: Zones(()))
    recent: dict[int, LiveSlot] = field(default_factory=dict)
    heard_ns: int | None = None
    now_s: Callable[[], float] = time.monotonic
    quiet_s: float = QUIET_S
    _heard_s: float = 0.0
    _slot_s: float = 0.0
    _there: bool = False  # what followers were told
    _queues: dict[asyncio.Queue[Encoded], str] = field(default_factory=dict)  # to addresses
    _loop: asyncio.AbstractEventLoop | None = None

    def listen(self, transport: Transport) -> None:
        """Follow the site from now on."""
        Follower(self.site).listen(transport, self._take_poses, self._take_status)

    def attach(self, loop: asyncio.AbstractEventLoop | None) -> None:
        """Serve followers on this event loop from now on; None stops."""
        self._loop = loop

    @property
    def followers(self) -> int:
        """How many follow."""
        return len(self._queues)

    def full(self, address: str) -> bool:
        """Return whether no more can follow from an address."""
        held = list(self._queues.values())
        return len(held) >= MAX_FOLLOWERS or held.count(address) >= MAX_OF_ADDRESS

    def silent_s(self) -> float | None:
        """Return how long the edge has been silent; None if it was never heard."""
        return None if self.heard_ns is None else self.now_s() - self._heard_s

    def there(self) -> bool:
        """Return whether the edge was heard lately."""
        silent_s = self.silent_s()
        return silent_s is not None and silent_s < self.quiet_s

    def edge_ns(self) -> int | None:
        """Return the time by the edge's clock, as of its newest slot; None before the first."""
        if self.slot is None:
            return None
        said_ns = self.slot.published_ns or self.slot.time_ns
        return said_ns + round((self.now_s() - self._slot_s) * 1e9)

    def slot_at(self, time_ns: int) -> LiveSlot | None:
        """Return the slot nearest to a time by the edge's clock; None without slots."""
        slots = list(self.recent.values())
        return min(slots, key=lambda slot: abs(slot.time_ns - time_ns), default=None)

    async def watch(self) -> None:
        """Tell followers when the edge goes, until cancelled."""
        while True:
            if self._there and not self.there():
                self._there = False
                self._put(event_of_edge(False, self.heard_ns))
            await asyncio.sleep(WATCH_S)

    @asynccontextmanager
    async def follow(self, address: str) -> AsyncIterator[asyncio.Queue[Encoded]]:
        """Yield a queue with the edge, the newest status and slot first, and then all that comes.

        Args:
            address: of the follower.

        Raises:
            TooMany: when there are `MAX_FOLLOWERS` already, or `MAX_OF_ADDRESS` of the address.
        """
        if self.full(address):
            raise TooMany
        queue: asyncio.Queue[Encoded] = asyncio.Queue(MAX_WAITING)
        queue.put_nowait(event_of_edge(self._there, self.heard_ns))
        if self.status is not None:
            queue.put_nowait(event_of_status(self.status))
        if self.slot is not None:
            queue.put_nowait(event_of_slot(self.slot, self.zones.counts()))
        self._queues[queue] = address
        try:
            yield queue
        finally:
            del self._queues[queue]

    def _hear(self) -> None:
        self._heard_s, self.heard_ns = self.now_s(), time.time_ns()
        if not self._there:
            self._there = True
            if self._queues:
                self._hand_on(event_of_edge(True, self.heard_ns))

    def _take_poses(self, poses: Poses) -> None:
        self._hear()
        self._slot_s, self.slot = self.now_s(), live_slot(poses)
        self.recent[self.slot.slot] = self.slot
        while len(self.recent) > MAX_RECENT:
            self.recent.pop(next(iter(self.recent)), None)
        self.zones, events = advance(self.zones, self.slot)
        if self._queues:
            self._hand_on(event_of_slot(self.slot, self.zones.counts()))
            for event in events:
                self._hand_on(event_of_zone(event))

    def _take_status(self, status: Status) -> None:
        self._hear()
        self.status = status
        if self._queues:
            self._hand_on(event_of_status(status))

    def _hand_on(self, event: Encoded) -> None:
        loop = self._loop  # read once: another thread detaches it
        if loop is not None:
            with suppress(RuntimeError):  # closed
                loop.call_soon_threadsafe(self._put, event)

    def _put(self, event: Encoded) -> None:
        for queue in self._queues:
            if queue.full():
                queue.get_nowait()
            queue.put_nowait(event)
