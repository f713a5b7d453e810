"""How long the API takes for ten seconds of poses while a site runs, and what a viewer costs.

Run: python lab/benchmarks/bench_view.py [--requests 400]

The site is that of `e3pose up --example --view`: an edge, four cameras and the view, a process
each. Its store begins with ten minutes of four people at 25 slots per second and goes on being
written. Two programs follow the live stream; a third asks `/api/poses` for ten seconds at random
places of the ten minutes, twenty times a second. The reference is the same question to the store
itself, between the requests; beside both, how long this process takes to wake after a millisecond.
"""

from __future__ import annotations

import argparse
import multiprocessing
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path

import httpx
import numpy as np
from websockets.sync.client import connect as connect_socket

from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.pipeline import SlotRecord
from e3pose.settings.resolved import resolve_site
from e3pose.site.example import free_port, make_example
from e3pose.site.run import reduce_pauses
from e3pose.store import Run, Store, StoreWriter

FPS, PEOPLE, MINUTES, RANGE_S, PER_S = 25, 4, 10, 10, 20
START_S = 300.0  # for a machine that compiles first


def record(slot: int, rng: np.random.Generator, cameras: int = 4) -> SlotRecord:
    """Four people somewhere."""
    joints_m = rng.uniform(-3, 3, (PEOPLE, 17, 3))
    flags, zeros = np.ones(cameras, dtype=bool), np.zeros(cameras)
    return SlotRecord(
        slot=slot, time_s=slot / FPS, selected=flags, arrived=flags,
        people=People(np.arange(PEOPLE), joints_m, sigma_m=np.full((PEOPLE, 17), 0.01)),
        occlusion=zeros, deficit=zeros, next_selection=flags,
    )  # fmt: skip


def fill(site: Path, started_ns: int, rng: np.random.Generator) -> Path:
    """Write ten minutes into the store of a site that does not run yet; return its place."""
    resolved = resolve_site(site)
    assert resolved.file.store is not None and isinstance(resolved.file.store.place, Path)
    place, cameras = resolved.file.store.place, resolved.rig.camera_ids
    run = Run(resolved.file.name, "before", started_ns, 1 / FPS, "coco17", COCO17.joints, cameras)
    with StoreWriter(place, run) as writer:
        for slot in range(MINUTES * 60 * FPS):
            writer.append(record(slot, rng, len(cameras)), wait=True)
        assert writer.flush(60.0)
    return place


def follow(url: str, count: Synchronized[int]) -> None:
    """Count what the live stream sends, until killed."""
    with connect_socket(url.replace("http", "ws") + "api/live") as socket:
        while True:
            socket.recv()
            count.value += 1


def main() -> None:
    """Print quantiles in milliseconds and their ratio to the reference."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--requests", type=int, default=400)
    requests = parser.parse_args().requests
    rng = np.random.default_rng(0)
    started_ns = time.time_ns() - 2 * MINUTES * 60 * 10**9
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        site, port = make_example(Path(name) / "site"), free_port()
        site.write_text(f'{site.read_text()}\n[view]\nlisten = "127.0.0.1:{port}"\n')
        store = Store(fill(site, started_ns, rng))
        command = [sys.executable, "-m", "e3pose", "up", str(site), "--quiet", "--view"]
        program = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        stack.callback(program.wait)
        stack.callback(program.terminate)
        url = f"http://127.0.0.1:{port}/"
        client = stack.enter_context(httpx.Client(base_url=url, timeout=60))
        until_works(client)
        counts = [multiprocessing.Value("q") for _ in range(2)]
        for count in counts:
            follower = multiprocessing.Process(target=follow, args=(url, count), daemon=True)
            follower.start()
            stack.callback(follower.kill)
        reduce_pauses()  # else this process looks for garbage while it waits for an answer
        took_ms, reference_ms, wake_ms = list[float](), list[float](), list[float]()
        for start_s in rng.uniform(0, MINUTES * 60 - RANGE_S, requests):
            next_s = time.perf_counter() + 1 / PER_S
            start_ns = started_ns + int(start_s * 1e9)
            end_ns = start_ns + RANGE_S * 10**9 - 1
            begun_s = time.perf_counter()
            answer = client.get("/api/poses", params={"start": str(start_ns), "end": str(end_ns)})
            took_ms.append(1000 * (time.perf_counter() - begun_s))
            assert answer.content.count(b'"people":') == RANGE_S * FPS, answer.text[:200]
            begun_s = time.perf_counter()
            store.query(start_ns, end_ns)
            reference_ms.append(1000 * (time.perf_counter() - begun_s))
            begun_s = time.perf_counter()
            time.sleep(0.001)
            wake_ms.append(1000 * (time.perf_counter() - begun_s) - 1)
            time.sleep(max(0.0, next_s - time.perf_counter()))
        size_kb = len(answer.content) / 1000
    named = {"GET /api/poses": took_ms, "Store.query": reference_ms, "waking": wake_ms}
    print(f"{requests} requests of {RANGE_S} s, {PEOPLE} people, {size_kb:.0f} kB, ms")
    for what, ms in named.items():
        p50, p90, p99 = np.quantile(ms, [0.5, 0.9, 0.99])
        print(f"{what:16} median {p50:5.1f}  90 % {p90:5.1f}  99 % {p99:5.1f}")
    print(f"ratio of medians {np.median(took_ms) / np.median(reference_ms):.2f}")
    print(f"followers got {counts[0].value} and {counts[1].value} messages meanwhile")


def until_works(client: httpx.Client) -> None:
    """Wait until the site computes slots."""
    end_s = time.monotonic() + START_S
    while time.monotonic() < end_s:
        with suppress(httpx.TransportError):
            if client.get("/api/status").status_code == 200:
                time.sleep(3.0)  # past the start of everything
                return
        time.sleep(0.2)
    raise SystemExit("the site does not start")


if __name__ == "__main__":
    main()
