"""Measure the store: what keeping a slot costs the loop, and how soon a question is answered."""

from __future__ import annotations

import argparse
import multiprocessing
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.pipeline import SlotRecord
from e3pose.store import Run, Store, StoreWriter
from e3pose.store.rows import Row, slot_rows
from e3pose.store.saver import Delivery

FPS, PEOPLE, CAMERAS = 25, 4, 5
DAY_SLOTS = 8 * 3600 * FPS
STAY_SLOTS = 10 * 60 * FPS  # after which four others come
APPEND_LIMIT_MS, QUERY_LIMIT_MS = 1.0, 20.0
STARTED_NS = 1_795_000_000_000_000_000
STEP_NS = 10**9 // FPS


def make_record(slot: int, rng: np.random.Generator) -> SlotRecord:
    """Return a slot of four people who stay for ten minutes."""
    selected = np.arange(CAMERAS) % 2 == slot % 2
    return SlotRecord(
        slot=slot,
        time_s=slot / FPS,
        selected=selected,
        arrived=selected,
        people=People(
            np.arange(PEOPLE) + slot // STAY_SLOTS * PEOPLE,
            rng.normal(size=(PEOPLE, 17, 3)),
            rng.uniform(0.1, 1, (PEOPLE, 17)),
            sigma_m=np.full((PEOPLE, 17), 0.01),
        ),
        occlusion=rng.random(CAMERAS),
        deficit=rng.random(CAMERAS),
        next_selection=~selected,
        stage_s={"match": 0.001},
    )


def make_run() -> Run:
    cameras = tuple(f"c{index}" for index in range(CAMERAS))
    return Run("bench", "day", STARTED_NS, 1 / FPS, "coco17", COCO17.joints, cameras)


def build_day(path: Path, slots: int) -> float:
    """Write slots in large transactions; return how long it took."""
    rng = np.random.default_rng(0)
    energy_j = np.full(CAMERAS, 0.2)
    # The content of a hundred slots again and again: their place is what the question depends on.
    patterns = [slot_rows(make_record(s, rng), 0, energy_j) for s in range(100)]
    delivery, begin_s = Delivery(f"sqlite:///{path}"), time.perf_counter()
    for start in range(0, slots, 2000):
        rows: list[Row] = []
        for slot in range(start, min(start + 2000, slots)):
            place = {"slot": slot, "time_ns": STARTED_NS + slot * STEP_NS}
            for table, row in patterns[slot % 100]:
                whole = {**row, **place}
                if table == "poses":
                    whole["track_id"] += slot // STAY_SLOTS * PEOPLE
                rows.append((table, whole))
        delivery.commit(rows, make_run())
    delivery.close()
    return time.perf_counter() - begin_s


def time_questions(path: Path, slots: int, number: int) -> NDArray[np.float64]:
    """Return milliseconds of questions for ten seconds of one person, at random times."""
    rng = np.random.default_rng(1)
    store, times_ms = Store(path), []
    for slot in rng.integers(0, max(1, slots - 10 * FPS), number).tolist():
        track = slot // STAY_SLOTS * PEOPLE + int(rng.integers(PEOPLE))
        start = STARTED_NS + slot * STEP_NS
        begin_s = time.perf_counter()
        found = store.query(start, start + 10 * 10**9, track=track)
        times_ms.append(1000 * (time.perf_counter() - begin_s))
        assert 1 <= len(found) <= 10 * FPS + 1
    return np.array(times_ms)


def ask_all_the_time(path: Path, stop: Any) -> None:
    """Be the reader at work: the last ten seconds of one person, twenty times a second."""
    store = Store(path)
    while not stop.is_set():
        runs = store.runs()
        if runs:
            newest = max((row["last_ns"] for row in store.rows("tracks")), default=STARTED_NS)
            store.query(newest - 10 * 10**9, newest, track=0)
        stop.wait(0.05)


def work(seconds: float) -> None:
    """Be the rest of a slot: arrays and plain Python."""
    end_s = time.perf_counter() + seconds
    values = np.random.default_rng(0).normal(size=(40, 40))
    while time.perf_counter() < end_s:
        np.linalg.svd(values)
        sum(range(1000))


def time_slots(path: Path | None, seconds: float, rate: float) -> dict[str, NDArray[np.float64]]:
    """Run slots of 5 ms of work at a rate, with or without a store; return milliseconds."""
    rng = np.random.default_rng(2)
    records = [make_record(slot, rng) for slot in range(int(seconds * rate))]
    energy_j = np.full(CAMERAS, 0.2)
    writer = None if path is None else StoreWriter(path, make_run())
    append_ms, slot_ms = [], []
    next_s = time.perf_counter()
    for record in records:
        next_s += 1 / rate
        time.sleep(max(0.0, next_s - time.perf_counter()))
        begin_s = time.perf_counter()
        work(0.005)
        middle_s = time.perf_counter()
        if writer is not None:
            assert writer.append(record, energy_j=energy_j)
        end_s = time.perf_counter()
        append_ms.append(1000 * (end_s - middle_s))
        slot_ms.append(1000 * (end_s - begin_s))
    if writer is not None:
        assert writer.flush()
        status = writer.status()
        assert status.acknowledged_slot == len(records) - 1
        assert status.shed == status.spooled == 0
        writer.close()
    return {"append": np.array(append_ms), "slot": np.array(slot_ms)}


def percentiles(times_ms: NDArray[np.float64]) -> dict[str, float]:
    p50, p99 = np.percentile(times_ms, [50, 99]).tolist()
    return {"p50_ms": p50, "p99_ms": p99, "max_ms": float(times_ms.max())}


def show(label: str, row: dict[str, float]) -> None:
    print(
        f"{label:<44} p50 {row['p50_ms']:8.3f}  p99 {row['p99_ms']:8.3f}  max {row['max_ms']:8.3f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--slots", type=int, default=DAY_SLOTS, help="of the day that is asked")
    parser.add_argument("--seconds", type=float, default=20, help="of appending")
    parser.add_argument("--rate", type=float, default=FPS, help="slots per second appended")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        live = Path(folder) / "live.db"
        with StoreWriter(live, make_run()):
            pass
        stop = multiprocessing.get_context("spawn").Event()
        reader = multiprocessing.get_context("spawn").Process(
            target=ask_all_the_time, args=(live, stop), daemon=True
        )
        reader.start()
        time.sleep(2)  # the reader's imports are not the reader at work
        without = time_slots(None, options.seconds, options.rate)
        kept = time_slots(live, options.seconds, options.rate)
        stop.set()
        reader.join()
        appending = percentiles(kept["append"])
        count = len(kept["append"])
        print(
            f"{count} slots of {PEOPLE} people at {options.rate:g} a second, a reader at work; ms"
        )
        show("append(record)", appending)
        show("a slot of 5 ms of work, with the store", percentiles(kept["slot"]))
        show("the same without a store", percentiles(without["slot"]))
        good = appending["p99_ms"] <= APPEND_LIMIT_MS
        print(f"append p99: {'within' if good else 'NOT within'} {APPEND_LIMIT_MS:g} ms\n")

        day = Path(folder) / "day.db"
        build_s = build_day(day, options.slots)
        size = os.path.getsize(day)
        print(
            f"{options.slots} slots written in {build_s:.0f} s, {size / 1e6:.0f} MB, "
            f"{size / options.slots:.0f} bytes per slot"
        )
        begin_s = time.process_time()
        asking = percentiles(time_questions(day, options.slots, 100))
        cpu_ms = 10 * (time.process_time() - begin_s)
        show("ten seconds of one person", asking)
        print(f"processor time a question: {cpu_ms:.1f} ms (the rest is waiting for a processor)")
        good = asking["p99_ms"] <= QUERY_LIMIT_MS
        print(f"query p99: {'within' if good else 'NOT within'} {QUERY_LIMIT_MS:g} ms")


if __name__ == "__main__":
    main()
