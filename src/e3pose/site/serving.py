"""Serve an ASGI application on a socket whose connections are bounded, on a thread of its own."""

from __future__ import annotations

import asyncio
import socket
import ssl
import threading
from contextlib import suppress
from typing import Any

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from e3pose.base.listener import Bounds, Listener

END_S = 5.0
PING_S = 60.0  # for a browser on a busy machine to answer a ping
MAX_MESSAGE_BYTES = 4096  # of a WebSocket, to us
CONNECTIONS, PER_ADDRESS = 256, 64


class Http(H11Protocol):
    """HTTP of uvicorn, which also says since when it waits for its client."""

    _since_s = 0.0
    _deaf_since_s: float | None = None

    def connection_made(self, transport: Any) -> None:
        """Wait for the first request."""
        super().connection_made(transport)
        self._since_s = self.loop.time()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        super().on_response_complete()
        self._since_s = self.loop.time()

    def pause_writing(self) -> None:
        """Wait for the client to take some of the answer."""
        super().pause_writing()
        self._deaf_since_s = self.loop.time()

    def resume_writing(self) -> None:
        """Go on with the answer."""
        super().resume_writing()
        self._deaf_since_s = None

    @property
    def waiting_since_s(self) -> float | None:
        """See `e3pose.base.listener.Listener.make`."""
        if self._deaf_since_s is not None:
            return self._deaf_since_s
        unread = self.conn.their_state in (h11.IDLE, h11.SEND_BODY)
        return self._since_s if unread else None


class Serving:
    """A server at work, until `close`."""

    def __init__(
        self, app: Any, listening: socket.socket, bounds: Bounds, secure: ssl.SSLContext | None
    ) -> None:
        """Start to serve; return once it does.

        Args:
            app: the ASGI application.
            listening: where; closed at the end.
            bounds: of its connections.
            secure: of https; None for plain http.
        """
        self._listening = listening
        config = uvicorn.Config(
            app,
            http=Http,
            log_level="error",
            access_log=False,
            server_header=False,
            proxy_headers=False,  # the door reads them, of proxies that the site file names
            ws="websockets-sansio",
            ws_max_size=MAX_MESSAGE_BYTES,
            ws_ping_timeout=PING_S,
            timeout_graceful_shutdown=1,
        )
        self._server = server = uvicorn.Server(config)

        def make() -> Http:
            return Http(config, server.server_state, server.lifespan.state)

        self._listener = Listener(listening, make, bounds, secure)
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._run()), name="view", daemon=True
        )
        self._thread.start()
        started = threading.Event()
        while not server.started and self._thread.is_alive():
            started.wait(0.01)

    def running(self) -> bool:
        """Return whether it serves."""
        return self._thread.is_alive()

    def close(self) -> None:
        """End."""
        self._server.should_exit = True
        self._thread.join(END_S)
        self._server.force_exit = True
        self._thread.join(END_S)
        self._listening.close()

    async def _run(self) -> None:
        accepting = asyncio.create_task(self._accept())
        try:
            await self._server.serve([])
        finally:
            accepting.cancel()
            with suppress(asyncio.CancelledError):
                await accepting

    async def _accept(self) -> None:
        while not self._server.started:  # its application must have started
            await asyncio.sleep(0.005)
        await self._listener.run()
