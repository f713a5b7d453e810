"""A hostile site of a hub: `python hostile_site.py NAME ENDPOINT HABIT` serves until killed.

`slow` answers at the last moment and always has more; `endless` has a hundred summaries more at
once, each of an hour of its own; `large` fills them with names; `deaf` never answers; `junk` is no
site at all.
"""

from __future__ import annotations

import sys
import threading
import time
from typing import Any

import msgspec

from e3pose.edge.consumers import Consumers
from e3pose.wire.access import Link
from e3pose.wire.codec import decode, encode
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.network import open_network
from e3pose.wire.site_messages import OutboxPart, OutboxQuestion

HOUR_NS, ROWS = 3600 * 10**9, 100
SLOW_S = 9.0


def row(number: int, **more: Any) -> dict[str, Any]:
    """Return a summary that is well formed."""
    return {
        "number": number, "started_ns": 1, "time_ns": number * HOUR_NS, "version": 1,
        "span_s": 60.0, "software": "evil", "slots": 1, "views": None, "people": None,
        "most_people": 0, "error_mm": None, "took_ms": None, "blind": {}, "zones": {},
        "entered": {}, "states": {}, "events": {}, "joules": {}, "charge": {}, "faults": [], **more,
    }  # fmt: skip


def main(name: str, endpoint: str, habit: str) -> None:
    large = {f"{at}".zfill(400): 1.0 for at in range(190)}

    def answer(_: str, payload: bytes) -> bytes | None:
        after = decode(payload, OutboxQuestion, "hub").after
        if habit == "deaf":
            threading.Event().wait()
        if habit == "junk":
            return b"\xff" * 900_000
        if habit == "slow":
            time.sleep(SLOW_S)
        count = {"slow": 1, "large": 5}.get(habit, ROWS)
        more = {"zones": large, "states": large} if habit == "large" else {}
        rows = [row(after + 1 + at, **more) for at in range(count)]
        return encode(OutboxPart(7, after + 10**6, 0, msgspec.json.encode(rows)))

    transport = open_network(Link("edge", name, read_endpoint(endpoint)))
    Consumers(outbox=answer).listen(transport, name)
    print("serving", flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    main(*sys.argv[1:])
