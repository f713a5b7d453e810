"""What the live page's time line costs the server of a site that has stored a day.

Run: python lab/benchmarks/bench_timeline.py [--hours 24]

The store has a slot every 40 ms and two people all the time. Asked is what a page asks every ten
seconds while it shows a day: all of it, as until now, and only what is new since the last time.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from sqlalchemy import insert

from e3pose.model.skeleton import COCO17
from e3pose.store import Run, Store, StoreWriter, schema
from e3pose.store.database import database_url, writing_engine

FPS, CAMERAS, EVERY_S, TIMES = 25, 4, 10.0, 20
PARTS, AROUND = 200, 1.5  # as timeline.js has them: parts of a day, and how much more is asked for
BATCH = 50_000


def fill(place: Path, hours: float, began_ns: int) -> None:
    """Store the slots of some hours and two tracks."""
    run = Run("lab", "lab", began_ns, 1 / FPS, "coco17", COCO17.joints, ("a", "b", "c", "d"))
    StoreWriter(place, run).close()
    blob = np.zeros(CAMERAS, dtype="<f4").tobytes()
    slot = {
        "run_id": 1, "selected": "1100", "arrived": "1100", "next_selection": "0011",
        "occlusion": blob, "deficit": blob, "energy_j": blob, "took_s": 0.004, "blind": "",
    }  # fmt: skip
    count, row = round(hours * 3600 * FPS), run.row()
    with writing_engine(database_url(place)).begin() as connection:
        connection.execute(insert(schema.runs), {"run_id": 1, **row})
        for first in range(0, count, BATCH):
            some = range(first, min(first + BATCH, count))
            rows = [{**slot, "slot": s, "time_ns": began_ns + s * 10**9 // FPS} for s in some]
            connection.execute(insert(schema.slots), rows)
        last_ns = began_ns + count * 10**9 // FPS
        for track in range(2):
            there = {"first_slot": 0, "last_slot": count, "first_ns": began_ns, "last_ns": last_ns}
            connection.execute(insert(schema.tracks), {"run_id": 1, "track_id": track, **there})


def cpu_ms(ask: Callable[[], object]) -> float:
    """Return the processor time of asking, median of some times."""
    taken = []
    for _ in range(TIMES):
        begun_s = time.process_time()
        ask()
        taken.append(1000 * (time.process_time() - begun_s))
    return float(np.median(taken))


def main() -> None:
    """Print what each way costs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=24.0)
    hours = parser.parse_args().hours
    part_ns = round(86_400 * 10**9 / PARTS)
    end_ns = time.time_ns() // part_ns * part_ns + part_ns // 2  # in the middle of a part
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "day.db"
        fill(place, hours, end_ns - round(hours * 3600e9))
        store = Store(place)
        store.runs()
        begin_ns = end_ns - round(AROUND * 86_400e9)
        parts = round(AROUND * PARTS)
        now_ns = end_ns // part_ns * part_ns
        whole_ms = cpu_ms(lambda: store.coverage(begin_ns, end_ns, parts))
        new_ms = cpu_ms(lambda: store.coverage(now_ns, now_ns + part_ns, 1))
    for name, took_ms in (("all of a day", whole_ms), ("what is new", new_ms)):
        print(f"{name}: {took_ms:.1f} ms, {took_ms / EVERY_S / 10:.2f} % of a core")


if __name__ == "__main__":
    main()
