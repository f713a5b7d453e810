"""A hostile client of a page over TLS, in a process of its own.

`python flood.py HOST:PORT TOKEN SITE` asks and holds connections in all ways at once until it is
killed: as often as it can, to open a site, half, without reading answers, and too much.
"""

from __future__ import annotations

import asyncio
import ssl
import sys
from contextlib import suppress

HERE = "127.0.0.2"  # another address than that of others
ASKING, OPENING, SILENT, DEAF, LARGE = 40, 10, 150, 20, 5  # connections


async def main(place: str, token: str, site: str) -> None:
    host, _, port = place.rpartition(":")
    secure = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    secure.check_hostname, secure.verify_mode = False, ssl.CERT_NONE
    head = f"Host: localhost\r\nAuthorization: Bearer {token}\r\n"
    look = f"GET /api/sites HTTP/1.1\r\n{head}\r\n".encode()
    body = f'{{"site": "{site}"}}'
    way = f"POST /api/open HTTP/1.1\r\n{head}Content-Type: application/json\r\n"
    go = f"{way}Content-Length: {len(body)}\r\n\r\n{body}".encode()
    large = f"{way}Content-Length: 100000000\r\n\r\n".encode() + b"x" * 1_000_000

    async def again(said: bytes, times: int, reads: bool) -> None:
        while True:
            with suppress(OSError):
                reader, writer = await asyncio.open_connection(
                    host, int(port), ssl=secure, local_addr=(HERE, 0)
                )
                for _ in range(times):
                    writer.write(said)
                    await writer.drain()
                    if reads and not await reader.read(2**20):
                        break
                if not reads:
                    await asyncio.sleep(3.0)
                writer.close()

    kinds = [(look, 1000, True)] * ASKING + [(go, 1000, True)] * OPENING
    kinds += [(b"", 1, False), (look[:-2], 1, False), (go[:-5], 1, False)] * (SILENT // 3)
    kinds += [(look, 200, False)] * DEAF + [(large, 1, False)] * LARGE
    print("flooding", flush=True)
    await asyncio.gather(*(again(*kind) for kind in kinds))


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
