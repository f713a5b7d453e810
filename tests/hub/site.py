"""A simulated site: a store with summaries, and the real answers of its edge over the network.

`python site.py NAME ENDPOINT STORE [KEYS]` serves until it is killed.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from e3pose.edge.consumers import Consumers
from e3pose.site.outbox_answers import OutboxAnswers
from e3pose.store.database import writing_engine
from e3pose.store.rows import Event, Run, event_row
from e3pose.store.saver import Delivery
from e3pose.store.summaries import MINUTE_NS, Minutes
from e3pose.wire.access import Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import certificates_in, read_roll
from e3pose.wire.network import open_network

MINUTE = 1_795_000_020_000_000_000


def run_of(site: str) -> Run:
    return Run(site, site, MINUTE, 0.04, "coco17", ("nose",), ("cam",), "e3pose 1.0")


def fill(store: Path, site: str, first: int, count: int) -> None:
    """Store summaries of so many minutes from one on, as a writer does."""
    summed = Minutes("e3pose 1.0", ("cam",), MINUTE + first * MINUTE_NS - 1, {})
    for minute in range(first, first + count):
        summed.take([event_row(Event(MINUTE + minute * MINUTE_NS, "lead", ""), minute)])
    rows = summed.closed(MINUTE + (first + count) * MINUTE_NS, ending=True)
    rows = [row for row in rows if row[1]["events"] != "{}"]
    assert len(rows) == count
    delivery = Delivery(f"sqlite:///{store}", summaries=100_000)
    delivery.commit(rows, run_of(site))
    delivery.close()


def main(name: str, endpoint: str, store: str, keys: str = "") -> None:
    writing_engine(f"sqlite:///{store}").dispose()
    if keys:
        roll = read_roll(Path(keys))
        link = Link("edge", name, read_endpoint(endpoint), certificates_in(Path(keys), "edge"))
        transport = open_network(link, roll)
    else:
        transport = open_network(Link("edge", name, read_endpoint(endpoint)))
    Consumers(outbox=OutboxAnswers(store, name).answer).listen(transport, name)
    print("serving", flush=True)
    while True:
        time.sleep(60)


if __name__ == "__main__":
    main(*sys.argv[1:])
