"""A WebSocket server of Foxglove's protocol: channels that clients subscribe to, nothing else.

Foxglove's own server takes any number of clients, from any page of the internet that the browser on
this machine shows. This one speaks the part of the protocol that a live stream needs
(https://github.com/foxglove/ws-protocol, subprotocol `foxglove.sdk.v1`), behind a listener that
bounds connections, to pages of named origins, with a short queue for each client.
"""

from __future__ import annotations

import asyncio
import base64
import json
import struct
import time
from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

from e3pose.wire.endpoint import is_loopback

PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
CLIENTS, CLIENTS_OF_ADDRESS = 32, 16
WAITING = 32  # messages that a slow client has not taken; the newest win
MAX_SUBSCRIPTIONS = 64
MAX_REPORTED = 10  # origins
MESSAGE_DATA = 1
ERROR = 2
REFUSED = 4403

Send = Callable[[dict[str, Any]], Awaitable[None]]
Receive = Callable[[], Awaitable[dict[str, Any]]]


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic that clients can subscribe to.

    Attributes:
        topic: its name.
        encoding: of its messages: `json` or `protobuf`.
        schema_name: of the schema; empty for none.
        schema: of protobuf, its descriptors.
    """

    topic: str
    encoding: str
    schema_name: str = ""
    schema: bytes = b""

    def advertised(self, channel_id: int) -> dict[str, Any]:
        """Return the channel's advertisement."""
        return {
            "id": channel_id,
            "topic": self.topic,
            "encoding": self.encoding,
            "schemaName": self.schema_name or self.topic.strip("/"),
            "schemaEncoding": "protobuf" if self.schema else "jsonschema",
            "schema": base64.b64encode(self.schema).decode(),
        }


@dataclass(eq=False)
class _Client:
    """A client with its subscriptions and its waiting messages.

    Messages are put in on any thread. One that does not take any costs its loop nothing more: the
    loop is woken once for all that came since it last looked.
    """

    loop: asyncio.AbstractEventLoop
    channels: dict[int, int] = field(default_factory=dict)  # by subscription; replaced whole
    waiting: deque[tuple[int, int, bytes]] = field(default_factory=lambda: deque(maxlen=WAITING))
    ready: asyncio.Event = field(default_factory=asyncio.Event)
    woken: bool = False

    def put(self, channel: int, time_ns: int, payload: bytes) -> None:
        """Let a message wait for the client; on any thread."""
        wanted = [number for number, subscribed in self.channels.items() if subscribed == channel]
        self.waiting.extend((number, time_ns, payload) for number in wanted)
        if wanted and not self.woken:
            self.woken = True
            with suppress(RuntimeError):  # its loop has ended
                self.loop.call_soon_threadsafe(self.ready.set)

    async def taken(self) -> bytes:
        """Return the next message as it is sent, once there is one."""
        while not self.waiting:
            await self.ready.wait()
            self.ready.clear()
            self.woken = False  # before the next look at what waits: what comes later wakes again
        number, time_ns, payload = self.waiting.popleft()
        return struct.pack("<BIQ", MESSAGE_DATA, number, time_ns) + payload


class FoxgloveServer:
    """An ASGI application that sends logged messages to subscribers."""

    def __init__(
        self,
        name: str,
        channels: Sequence[Channel],
        origins: frozenset[str],
        report: Callable[[str], object],
    ) -> None:
        """Describe a server.

        Args:
            name: shown to clients.
            channels: with ids from 1.
            origins: of web pages that may connect, beside those on this machine.
            report: called with a line for operators when a page is refused.
        """
        self._origins, self._report = origins, report
        self._ids = {channel.topic: number for number, channel in enumerate(channels, 1)}
        session = str(time.time_ns() // 10**6)
        self._greeting = [
            {
                "op": "serverInfo",
                "name": name,
                "capabilities": [],
                "metadata": {},
                "sessionId": session,
            },
            {"op": "advertise", "channels": [c.advertised(self._ids[c.topic]) for c in channels]},
        ]
        self._clients: set[_Client] = set()
        self._reported: set[str] = set()

    def log(self, topic: str, payload: bytes, time_ns: int) -> None:
        """Send a message to the subscribers of its topic; thread-safe, never waits."""
        for client in list(self._clients):
            client.put(self._ids[topic], time_ns, payload)

    def lets_in(self, origin: str | None) -> bool:
        """Return whether a page of an origin may connect; programs that are no browser have none.

        Pages of this machine may: who can serve one here can connect without it.
        """
        if origin is None or origin in self._origins:
            return True
        try:
            return is_loopback(urlsplit(origin).hostname or "")
        except ValueError:
            return False

    async def __call__(self, scope: Mapping[str, Any], receive: Receive, send: Send) -> None:
        """Serve a connection."""
        if scope["type"] == "http":
            start = {"type": "http.response.start", "status": 426, "headers": []}
            await send(start)
            await send({"type": "http.response.body", "body": b"a WebSocket of Foxglove"})
        elif scope["type"] == "websocket":
            await self._connect(scope, receive, send)

    async def _connect(self, scope: Mapping[str, Any], receive: Receive, send: Send) -> None:
        await receive()
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        origin = headers.get(b"origin")
        offered = [one for one in PROTOCOLS if one in scope["subprotocols"]]
        if not self.lets_in(origin) or not offered:
            if offered and origin not in self._reported and len(self._reported) < MAX_REPORTED:
                self._reported.add(str(origin))
                self._report(
                    f"foxglove: refused a page of {str(origin)[:80]!r}; add ?origin=ORIGIN to the "
                    "target to allow it"
                )
            await send({"type": "websocket.close", "code": REFUSED})
            return
        await send({"type": "websocket.accept", "subprotocol": offered[0]})
        client = _Client(asyncio.get_running_loop())
        self._clients.add(client)
        tasks = [
            asyncio.create_task(self._send(client, send)),
            asyncio.create_task(self._hear(client, receive, send)),
        ]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._clients.discard(client)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _send(self, client: _Client, send: Send) -> None:
        for said in self._greeting:
            await send({"type": "websocket.send", "text": json.dumps(said)})
        while True:
            await send({"type": "websocket.send", "bytes": await client.taken()})

    async def _hear(self, client: _Client, receive: Receive, send: Send) -> None:
        while (message := await receive())["type"] == "websocket.receive":
            problem = self._take(client, message.get("text"))
            if problem:
                said = {"op": "status", "level": ERROR, "message": problem}
                await send({"type": "websocket.send", "text": json.dumps(said)})

    def _take(self, client: _Client, text: str | None) -> str:
        """Handle a request of a client; return its problem, empty without one."""
        try:
            said = json.loads(text or "")
            if said["op"] == "subscribe":
                for one in said["subscriptions"]:
                    subscription, channel = int(one["id"]), int(one["channelId"])
                    if channel not in self._ids.values():
                        return f"Unknown channel ID: {channel}"
                    if not 0 <= subscription < 2**32 or len(client.channels) >= MAX_SUBSCRIPTIONS:
                        return "Too many subscriptions"
                    client.channels = {**client.channels, subscription: channel}
            elif said["op"] == "unsubscribe":
                ended = {int(subscription) for subscription in said["subscriptionIds"]}
                client.channels = {i: c for i, c in client.channels.items() if i not in ended}
        except (ValueError, TypeError, KeyError, RecursionError, OverflowError):
            return "Invalid message"
        return ""
