"""How long the API takes for ten seconds of poses while a site runs, and what a viewer costs.

Run: python benchmarks/bench_view.py [--requests 400]

A store with ten minutes of four people at 25 slots a second goes on being written; two programs
follow the live stream; one after the other asks `/api/poses` for ten seconds at random places. The
reference is the same question to the store itself, between the requests, in this process.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import httpx
import numpy as np
from websockets.sync.client import connect as connect_socket

from e3pose.geometry.rigs import ring_rig
from e3pose.model.pose import Poses3D
from e3pose.model.skeleton import COCO17
from e3pose.pipeline import SlotRecord
from e3pose.recording.calibration import save_rig
from e3pose.settings.live import live_site
from e3pose.settings.site_file import load_site
from e3pose.store import Run, Store, StoreWriter
from e3pose.view.program import open_view
from e3pose.view.rates import Rate
from e3pose.wire.codec import encode, pack
from e3pose.wire.memory import Hub
from e3pose.wire.messages import Poses

FPS, PEOPLE, MINUTES, RANGE_S = 25, 4, 10, 10
SITE = 'format = "e3pose-site"\nversion = 1\nname = "lab"\ncalibration = "rig.toml"\nfps = 25\n'


def record(slot: int, rng: np.random.Generator) -> SlotRecord:
    """Four people somewhere."""
    joints_m = rng.uniform(-3, 3, (PEOPLE, 17, 3))
    flags, zeros = np.ones(4, dtype=bool), np.zeros(4)
    return SlotRecord(
        slot=slot, time_s=slot / FPS, selected=flags, arrived=flags,
        poses=Poses3D(joints_m, np.ones((PEOPLE, 17))), track_ids=np.arange(PEOPLE),
        occlusion=zeros, deficit=zeros, next_selection=flags,
        covariance_m2=np.tile(np.eye(3) * 1e-4, (PEOPLE, 17, 1, 1)),
        measured=np.ones((PEOPLE, 17), dtype=bool),
    )  # fmt: skip


def message(made: SlotRecord, time_ns: int) -> bytes:
    """The same people as the edge publishes them."""
    return encode(
        Poses(
            made.slot, time_ns, COCO17.joints, pack(made.track_ids.astype(np.int64)),
            pack(made.poses.joints_m.astype(np.float32)),
            pack(np.full((PEOPLE, 17), 0.01, dtype=np.float32)), pack(made.measured),
        )
    )  # fmt: skip


def main() -> None:
    """Print quantiles in milliseconds and their ratio to the reference."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--requests", type=int, default=400)
    requests = parser.parse_args().requests
    rng = np.random.default_rng(0)
    started_ns = time.time_ns() - MINUTES * 60 * 10**9
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder, hub, stop = Path(name), Hub(), threading.Event()
        (folder / "site.toml").write_text(SITE + '[store]\npath = "lab.db"\n')
        save_rig(ring_rig(4, 4.0, 2.0, (640, 480), rng), folder / "rig.toml")
        live = live_site(load_site(folder))
        run = Run("lab", "lab", started_ns, 1 / FPS, "coco17", COCO17.joints, live.rig.camera_ids)
        writer = stack.enter_context(StoreWriter(folder / "lab.db", run))
        slots = MINUTES * 60 * FPS
        for slot in range(slots):
            time_ns = started_ns + slot * 10**9 // FPS
            writer.append(record(slot, rng), time_ns=time_ns, wait=True)
        store = Store(folder / "lab.db")
        while not len(store.query(time_ns)):  # until the last of them is kept
            time.sleep(0.1)
        view = stack.enter_context(open_view(live, "127.0.0.1:0", transport=hub.join()))
        view.rules.reads = Rate(1e6, 1e6, time.monotonic)
        edge, counts = hub.join(), [0, 0]

        def publish() -> None:
            slot = slots
            while not stop.wait(1 / FPS):
                made, now_ns = record(slot, rng), time.time_ns()
                writer.append(made, time_ns=now_ns)
                edge.publish("e3pose/lab/poses", message(made, now_ns))
                slot += 1

        def follow(index: int) -> None:
            with connect_socket(view.url.replace("http", "ws") + "api/live") as socket:
                while not stop.is_set():
                    with suppress(TimeoutError):
                        socket.recv(1)
                        counts[index] += 1

        threads = [threading.Thread(target=publish)]
        threads += [threading.Thread(target=follow, args=(index,)) for index in range(2)]
        for thread in threads:
            thread.start()
        client = stack.enter_context(httpx.Client(base_url=view.url, timeout=60))
        took_ms, reference_ms = list[float](), list[float]()
        for start_s in rng.uniform(0, MINUTES * 60 - RANGE_S, requests):
            start_ns = started_ns + int(start_s * 1e9)
            end_ns = start_ns + RANGE_S * 10**9 - 1
            asked = {"start": str(start_ns), "end": str(end_ns)}
            begun_s = time.perf_counter()
            answer = client.get("/api/poses", params=asked)
            took_ms.append(1000 * (time.perf_counter() - begun_s))
            assert len(answer.json()["slots"]) == RANGE_S * FPS, answer.text[:200]
            begun_s = time.perf_counter()
            store.query(start_ns, end_ns)
            reference_ms.append(1000 * (time.perf_counter() - begun_s))
        stop.set()
        for thread in threads:
            thread.join()
        size_kb = len(answer.content) / 1000
    (p50, p99), (r50, r99) = (np.quantile(ms, [0.5, 0.99]) for ms in (took_ms, reference_ms))
    print(f"{requests} requests of {RANGE_S} s, {PEOPLE} people, {size_kb:.0f} kB")
    print(f"GET /api/poses  median {p50:5.1f} ms  99 % {p99:5.1f} ms")
    print(f"Store.query     median {r50:5.1f} ms  99 % {r99:5.1f} ms")
    print(f"ratio           median {p50 / r50:5.1f}     99 % {p99 / r99:5.1f}")
    print(f"followers got {counts[0]} and {counts[1]} slots meanwhile")


if __name__ == "__main__":
    main()
