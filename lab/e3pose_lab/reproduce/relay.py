"""A delayed link: a TCP relay on loopback with latency in both directions."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Iterator

STOP_S = 10.0


@contextlib.contextmanager
def relay(port: int, round_trip_s: float) -> Iterator[int]:
    """Yield the port of a relay to `port` that adds half the round trip in each direction.

    At the end it drops its connections.
    """
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, name="relay", daemon=True)
    thread.start()
    joined: set[asyncio.Task[None]] = set()

    async def join(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        joined.add(task)
        try:
            await _both_ways(reader, writer, port, round_trip_s / 2)
        finally:
            writer.close()
            joined.discard(task)

    async def stop() -> None:
        server.close()
        for task in tuple(joined):
            task.cancel()
        await asyncio.gather(*joined, return_exceptions=True)
        await asyncio.sleep(0)  # closed transports are let go in the loop's next round

    begin = asyncio.start_server(join, "127.0.0.1", 0)
    server = asyncio.run_coroutine_threadsafe(begin, loop).result(STOP_S)
    try:
        yield int(server.sockets[0].getsockname()[1])
    finally:
        asyncio.run_coroutine_threadsafe(stop(), loop).result(STOP_S)
        loop.call_soon_threadsafe(loop.stop)
        thread.join(STOP_S)
        loop.close()


async def _both_ways(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, port: int, delay_s: float
) -> None:
    try:
        there, away = await asyncio.open_connection("127.0.0.1", port)
    except OSError:  # the edge is not there yet: the camera tries again
        return
    try:
        await asyncio.gather(_pass_on(reader, away, delay_s), _pass_on(there, writer, delay_s))
    finally:
        away.close()


async def _pass_on(
    source: asyncio.StreamReader, target: asyncio.StreamWriter, delay_s: float
) -> None:
    loop = asyncio.get_running_loop()
    due: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()

    async def send() -> None:
        while (item := await due.get())[1]:
            await asyncio.sleep(max(0.0, item[0] - loop.time()))
            if not target.is_closing():  # the other end may be gone
                target.write(item[1])
        target.close()

    sending = asyncio.create_task(send())
    try:
        piece = b"x"
        while piece:
            try:
                piece = await source.read(65536)
            except OSError:
                piece = b""
            due.put_nowait((loop.time() + delay_s, piece))
        await sending
    finally:
        sending.cancel()
