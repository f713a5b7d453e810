"""A link that delays: a relay on loopback that passes on every byte late, in both directions."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def relay(port: int, round_trip_s: float) -> Iterator[int]:
    """Yield the port of a relay to `port` that adds half the round trip in each direction."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()

    async def serve() -> asyncio.Server:
        async def join(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            try:
                there, away = await asyncio.open_connection("127.0.0.1", port)
            except OSError:  # the edge is not there yet: the camera tries again
                writer.close()
                return
            await asyncio.gather(
                _pass_on(reader, away, round_trip_s / 2), _pass_on(there, writer, round_trip_s / 2)
            )

        return await asyncio.start_server(join, "127.0.0.1", 0)

    server = asyncio.run_coroutine_threadsafe(serve(), loop).result(timeout=5.0)
    try:
        yield int(server.sockets[0].getsockname()[1])
    finally:
        loop.call_soon_threadsafe(server.close)
        loop.call_soon_threadsafe(loop.stop)
        thread.join(timeout=5.0)


async def _pass_on(
    source: asyncio.StreamReader, target: asyncio.StreamWriter, delay_s: float
) -> None:
    loop = asyncio.get_running_loop()
    due: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()

    async def send() -> None:
        piece = b"x"
        while piece:
            due_s, piece = await due.get()
            await asyncio.sleep(max(0.0, due_s - loop.time()))
            with contextlib.suppress(OSError):
                target.write(piece)
        target.close()

    sending = asyncio.create_task(send())
    piece = b"x"
    while piece:
        try:
            piece = await source.read(65536)
        except OSError:
            piece = b""
        due.put_nowait((loop.time() + delay_s, piece))
    await sending
