"""Fan out an edge's messages to HTTP clients, as events and by WebSocket; the newest wins."""

from __future__ import annotations

import asyncio
import datetime
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal, NamedTuple

from fastapi import APIRouter, HTTPException, Query, Request, WebSocket, WebSocketDisconnect
from fastapi.responses import StreamingResponse

from e3pose.events import watch as watching
from e3pose.events.watch import Watch
from e3pose.model.person_event import PersonEvent
from e3pose.model.zone_event import ZoneEvent
from e3pose.settings.site_file import ZoneTable
from e3pose.site.connect import LiveSlot, live_slot
from e3pose.site.follow import Follower
from e3pose.site.streams.as_json import zone_words
from e3pose.site.web.access import PROTOCOL
from e3pose.site.web.notices import Notice, Surroundings, notices
from e3pose.site.web.schemas import (
    Encoded,
    event_of_edge,
    event_of_slot,
    event_of_status,
    event_of_told,
)
from e3pose.site.zones import Zones, advance
from e3pose.store.names import StoredNames
from e3pose.wire.site_messages import Poses, Status
from e3pose.wire.transport import Transport

MAX_WAITING = 32  # messages that a slow follower has not taken yet
MAX_FOLLOWERS, MAX_OF_ADDRESS = 64, 16
MAX_RECENT = 100
MAX_TOLD = 200
QUIET_S = 3.0  # without a word of the edge, which says something every second
WATCH_S = 0.25
KEEP_ALIVE_S = 15.0  # a comment for proxies between that close what is silent
FULL = "as many live views as the server takes, in all or from one address: close another"
FULL_CODE = 1013  # of a WebSocket: try again later
Delayed = Annotated[
    bool, Query(description="slots are the smoothed ones that the edge publishes later")
]
EVENTS: dict[int | str, dict[str, Any]] = {
    200: {
        "content": {"text/event-stream": {"schema": {"type": "string"}}},
        "description": "events `slot`, `status` and `zone` with JSON data",
    },
    503: {"description": FULL},
}


class TooMany(Exception):
    """There are as many followers as the server takes, in all or from one address."""


class Place(NamedTuple):
    """Where a follower is, and whether it follows the smoothed poses."""

    address: str
    delayed: bool


@dataclass(eq=False)
class Feed:
    """The newest messages of a site, and a queue for each follower.

    Attributes:
        site: its name.
        slot: the newest; None before the first.
        status: likewise.
        zones: who is in which.
        delayed_zones: likewise by the smoothed poses.
        delayed: the newest one that was smoothed; None before the first.
        recent: the newest slots by number, for pictures and smoothed poses, which come later.
        doing: who does what, by the poses at once; None where nobody follows it.
        since_ns: since when the people of the newest slot are there, by track: as the store says,
            and before it does, since the first slot that came here.
        told: the newest events of people, oldest first.
        around: looks at the site's disk and certificates.
        names: what people in sight are called.
        heard_ns: when the edge was last heard, nanoseconds since 1970; None before the first time.
        now_s: a clock that only goes forward.
        quiet_s: without a word of the edge, until it is told to be gone.
    """

    site: str
    slot: LiveSlot | None = None
    status: Status | None = None
    zones: Zones = field(default_factory=lambda: Zones(()))
    delayed: LiveSlot | None = None
    delayed_zones: Zones = field(default_factory=lambda: Zones(()))
    recent: dict[int, LiveSlot] = field(default_factory=dict)
    doing: Watch | None = None
    since_ns: dict[int, int] = field(default_factory=dict)
    told: deque[PersonEvent] = field(default_factory=lambda: deque(maxlen=MAX_TOLD))
    around: Surroundings = field(default_factory=Surroundings)
    names: StoredNames = field(default_factory=StoredNames)
    heard_ns: int | None = None
    now_s: Callable[[], float] = time.monotonic
    quiet_s: float = QUIET_S
    _wanted: tuple[ZoneTable, ...] | None = None
    _wanted_delayed: tuple[ZoneTable, ...] | None = None
    _heard_s: float = 0.0
    _slot_s: float = 0.0
    _there: bool = False  # what followers were told
    _telling: threading.Lock = field(default_factory=threading.Lock)
    _queues: dict[asyncio.Queue[Encoded], Place] = field(default_factory=dict)
    _loop: asyncio.AbstractEventLoop | None = None

    def listen(self, transport: Transport) -> None:
        """Follow the site from now on."""
        self.delayed_zones = self.zones
        Follower(self.site).listen(
            transport, self._take_poses, self._take_status, self._take_delayed
        )

    def rezone(self, zones: tuple[ZoneTable, ...]) -> None:
        """Use other zones from the next slot on; may be called on any thread."""
        self._wanted = self._wanted_delayed = zones

    def attach(self, loop: asyncio.AbstractEventLoop | None) -> None:
        """Serve followers on this event loop from now on; None stops."""
        self._loop = loop

    @property
    def followers(self) -> int:
        """The number of followers."""
        return len(self._queues)

    def full(self, address: str) -> bool:
        """Return whether no more can follow from an address."""
        held = [place.address for place in self._queues.values()]
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

    def smoothed_ms(self) -> float | None:
        """Return how late smoothed poses come; None where the edge publishes none lately."""
        if self.slot is None or self.delayed is None:
            return None
        behind_ms = (self.slot.time_ns - self.delayed.time_ns) / 1e6
        lately_ms = self.delayed.delay_ms + 1e3 * QUIET_S
        return self.delayed.delay_ms if behind_ms < lately_ms else None

    def slot_at(self, time_ns: int) -> LiveSlot | None:
        """Return the slot nearest to a time by the edge's clock; None without slots."""
        slots = list(self.recent.values())
        return min(slots, key=lambda slot: abs(slot.time_ns - time_ns), default=None)

    async def watch(self) -> None:
        """Tell followers when the edge goes, and how people are called, until cancelled."""
        while True:
            run_ns = 0 if self.status is None else self.status.run_ns
            if self._queues and self.names.due(run_ns):
                await asyncio.to_thread(self.look_at_names)
            if self._there and not self.there():
                self._there = False
                self._put(event_of_edge(False, self.heard_ns))
            await asyncio.sleep(WATCH_S)

    @asynccontextmanager
    async def follow(
        self, address: str, delayed: bool = False
    ) -> AsyncIterator[asyncio.Queue[Encoded]]:
        """Yield a queue with the edge, the newest status and slot first, and then all that comes.

        Args:
            address: of the follower.
            delayed: whether slots are the smoothed ones, in place of those at once.

        Raises:
            TooMany: when there are `MAX_FOLLOWERS` already, or `MAX_OF_ADDRESS` of the address.
        """
        if self.full(address):
            raise TooMany
        queue: asyncio.Queue[Encoded] = asyncio.Queue(MAX_WAITING)
        queue.put_nowait(event_of_edge(self._there, self.heard_ns))
        if self.status is not None:
            queue.put_nowait(self._status_event(self.status))
        slot, zones = (self.delayed, self.delayed_zones) if delayed else (self.slot, self.zones)
        if slot is not None:
            queue.put_nowait(event_of_slot(slot, zones, self.doing, self.since_ns))
        if self.told:
            queue.put_nowait(event_of_told(list(self.told)))
        self._queues[queue] = Place(address, delayed)
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
        if self._wanted is not None:
            self.zones, self._wanted = Zones(self._wanted), None
        self.zones, events = advance(self.zones, self.slot)
        now_ns, stored_ns = self.slot.time_ns, self.names.first_ns
        self.since_ns = {
            track: min(self.since_ns.get(track, now_ns), stored_ns.get(track, now_ns))
            for track in self.slot.people.track_ids.tolist()
        }
        self._follow_people(self.slot)
        self._tell(self.slot, self.zones, events, delayed=False)

    def _follow_people(self, slot: LiveSlot) -> None:
        """Follow the states of people, for viewers or for the site's events."""
        if self.doing is None or not (self.doing.rules or self._queues):
            return
        self.doing, told = watching.advance(self.doing, slot)
        self.told.extend(told)
        if told and self._queues:
            self._hand_on(event_of_told(told))

    def look_at_names(self) -> None:
        """Read people's names, and send changes to followers."""
        if self.status is not None and self.names.look(self.status.run_ns):
            self._tell_status()

    def called(self) -> dict[str, Any]:
        """Return the run of the store and its people's names, as a status has them."""
        named = [{"track": i, **one._asdict()} for i, one in self.names.called.items()]
        return {"run": self.names.run, "names": named}

    def notices(self) -> list[Notice]:
        """Return the notices of the site; none before its first status."""
        if self.status is None:
            return []
        now = datetime.datetime.now(datetime.timezone.utc)
        return notices(self.status, self.slot, self.around.look(now), now)

    def _status_event(self, status: Status) -> Encoded:
        return event_of_status(status, self.smoothed_ms(), self.notices(), self.called())

    def _take_delayed(self, poses: Poses) -> None:
        late = live_slot(poses)
        then = self.recent.get(late.slot)
        if then is not None:  # smoothed poses say nothing of cameras
            late = replace(late, selected=then.selected, arrived=then.arrived, blind=then.blind)
        self.delayed = late
        if self._wanted_delayed is not None:
            self.delayed_zones, self._wanted_delayed = Zones(self._wanted_delayed), None
        self.delayed_zones, events = advance(self.delayed_zones, late)
        self._tell(late, self.delayed_zones, events, delayed=True)

    def _tell(
        self, slot: LiveSlot, zones: Zones, events: Sequence[ZoneEvent], delayed: bool
    ) -> None:
        if any(place.delayed == delayed for place in list(self._queues.values())):
            self._hand_on(event_of_slot(slot, zones, self.doing, self.since_ns), delayed)
            for event in events:
                self._hand_on(Encoded("zone", zone_words(event)), delayed)

    def _take_status(self, status: Status) -> None:
        self._hear()
        self.status = status
        self._tell_status()

    def _tell_status(self) -> None:
        """Tell followers the newest status, a thread at a time: no older one comes after it."""
        with self._telling:
            if self._queues and self.status is not None:
                self._hand_on(self._status_event(self.status))

    def _hand_on(self, event: Encoded, delayed: bool | None = None) -> None:
        loop = self._loop  # read once: another thread detaches it
        if loop is not None:
            with suppress(RuntimeError):  # closed
                loop.call_soon_threadsafe(self._put, event, delayed)

    def _put(self, event: Encoded, delayed: bool | None = None) -> None:
        for queue, place in self._queues.items():
            if delayed is not None and place.delayed != delayed:
                continue
            if queue.full():
                queue.get_nowait()
            queue.put_nowait(event)


def make_live(feed: Feed) -> APIRouter:
    """Return the routes of a feed."""
    live = APIRouter(prefix="/api")

    @live.get("/live", summary="Slots and status as they come", response_class=StreamingResponse,
              responses=EVENTS)  # fmt: skip
    async def events(request: Request, delayed: Delayed = False) -> StreamingResponse:
        address = _address(request.state)
        if feed.full(address):
            raise HTTPException(503, FULL)

        async def stream() -> AsyncIterator[bytes]:
            async with feed.follow(address, delayed) as queue:
                yield b"retry: 1000\n\n"
                while True:
                    try:
                        event = await asyncio.wait_for(queue.get(), KEEP_ALIVE_S)
                        yield event.sse
                    except asyncio.TimeoutError:
                        yield b":\n\n"

        return StreamingResponse(stream(), media_type="text/event-stream")

    @live.websocket("/live")
    async def socket(
        websocket: WebSocket, format: Literal["json", "msgpack"] = "json", delayed: Delayed = False
    ) -> None:
        offered = websocket.scope.get("subprotocols") or []
        await websocket.accept(PROTOCOL if PROTOCOL in offered else None)
        try:
            async with feed.follow(_address(websocket.state), delayed) as queue:
                await _serve(websocket, queue, format)
        except TooMany:
            await websocket.close(FULL_CODE, FULL)

    return live


def _address(state: Any) -> str:
    """Return the client's address, as the access control found it."""
    return str(getattr(state, "client", ""))


async def _serve(websocket: WebSocket, queue: asyncio.Queue[Encoded], form: str) -> None:
    """Send events until the client leaves; its messages are ignored."""

    async def send() -> None:
        while True:
            event = await queue.get()
            if form == "json":
                await websocket.send_text(event.json.decode())
            else:
                await websocket.send_bytes(event.msgpack)

    async def watch() -> None:
        while (await websocket.receive())["type"] != "websocket.disconnect":
            pass

    tasks = [asyncio.create_task(send()), asyncio.create_task(watch())]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        for task in tasks:
            with suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await task
