"""The live part of the API: slots and status by server-sent events and WebSocket."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Query, Request, WebSocket, WebSocketDisconnect
from fastapi.responses import StreamingResponse

from e3pose.site.web.access import PROTOCOL
from e3pose.site.web.feed import Feed, TooMany
from e3pose.site.web.schemas import Encoded

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
