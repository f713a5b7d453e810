"""Do sites in one process keep each other warm? CPU of a slot beside neighbours, and lateness.

    python lab/benchmarks/bench_density.py
    python lab/benchmarks/bench_density.py --sites 1 7 14 --cameras 5 --people 4

Each site computes a slot every 40 ms, at a time of its own. `processes`: a process each, as sites
are today. `turns`: one thread of one process computes them in turn. `threads`: one process, a
thread each, as `e3pose edge A B C` would. All are bound to one core, by turns with each other. CPU
is that of the thread over the step of the pipeline alone, without network and store; late is from
when a slot was due until it was computed, median and 99th percentile.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import numpy as np

from bench_step import FPS, LEAD, SECONDS

INTERVAL_S = 1 / FPS
ROUNDS = 3
Slot = Callable[[], None]
Spent = list[tuple[float, float]]  # CPU, and lateness, of each slot in seconds


def make_site(cameras: int, people: int, seed: int) -> Slot:
    """Return what computes the next slot of a site, without end; kernels are compiled."""
    from e3pose.evaluate.replay import ReplaySettings, make_pipeline
    from e3pose.pipeline import initial_state, step
    from e3pose.simulate import SceneSettings, simulate

    scene = SceneSettings("ring", people=people, seconds=SECONDS, fps=FPS, cameras=cameras)
    recording = simulate(scene, seed=seed)
    pipeline = make_pipeline(recording, ReplaySettings(num_selected=2, lead_slots=LEAD), time.time)
    online, state, slot = np.ones(cameras, dtype=bool), initial_state(pipeline), 0

    def compute() -> None:
        nonlocal state, slot
        if slot == recording.num_slots:
            state, slot = initial_state(pipeline), 0
        ordered = np.flatnonzero(state.selections[0]).tolist()
        seen = {camera: recording.view(slot, camera) for camera in ordered}
        views = {camera: view for camera, view in seen.items() if view is not None}
        state, _ = step(pipeline, state, views, online)
        slot += 1

    for _ in range(recording.num_slots):
        compute()
    return compute


def paced(slots: list[Slot], offset_s: float, begin_s: float, seconds: float) -> Spent:
    """Compute the slots of sites in turn, evenly over the interval; return what each took."""
    spent: Spent = []
    for turn in range(round(seconds / INTERVAL_S)):
        for at, compute in enumerate(slots):
            due_s = begin_s + (turn + offset_s + at / len(slots)) * INTERVAL_S
            time.sleep(max(0.0, due_s - time.monotonic()))
            start_s = time.thread_time()
            compute()
            spent.append((time.thread_time() - start_s, time.monotonic() - due_s))
    return spent


def child(options: argparse.Namespace) -> None:
    """Measure in this process, once told to begin; print what each slot took."""
    first, count = options.child
    slots = [make_site(options.cameras, options.people, 701 + first + at) for at in range(count)]
    print("ready", flush=True)
    begin_s = float(sys.stdin.readline())
    spent: list[Spent] = []
    if options.threads:
        threads = [
            threading.Thread(
                target=lambda s=slot, o=at / count: spent.append(
                    paced([s], o, begin_s, options.seconds)
                )
            )
            for at, slot in enumerate(slots)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    else:
        spent.append(paced(slots, options.offset, begin_s, options.seconds))
    print(json.dumps([one for each in spent for one in each]))


def measured(options: argparse.Namespace, kind: str, sites: int) -> tuple[float, float, float]:
    """Return CPU of a slot, and median and 99th percentile of lateness, milliseconds."""
    apart = kind == "processes"
    groups = [(at, 1) for at in range(sites)] if apart else [(0, sites)]
    running = []
    for first, count in groups:
        words = [sys.executable, __file__, "--child", str(first), str(count)]
        words += ["--cameras", str(options.cameras), "--people", str(options.people)]
        words += ["--seconds", str(options.seconds), "--offset", str(first / sites * apart)]
        words += ["--threads"] if kind == "threads" else []
        running.append(
            subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        )
        assert running[-1].stdout is not None
        running[-1].stdout.readline()  # one compiles, the next find it
    begin_s = time.monotonic() + 0.5
    for process in running:
        assert process.stdin is not None
        process.stdin.write(f"{begin_s}\n")
        process.stdin.flush()
    found: Spent = []
    for process in running:
        assert process.stdout is not None
        found += json.loads(process.stdout.readline())
        process.wait()
    cpu, late = 1e3 * np.asarray(found).T
    return float(np.median(cpu)), float(np.median(late)), float(np.quantile(late, 0.99))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sites", type=int, nargs="+", default=[1, 4, 8, 16])
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--people", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--core", type=int, default=0)
    parser.add_argument("--child", type=int, nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--offset", type=float, default=0.0, help=argparse.SUPPRESS)
    parser.add_argument("--threads", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    os.sched_setaffinity(0, {options.core})
    if options.child:
        child(options)
        return
    print(f"{options.cameras} cameras, {options.people} people, {FPS:g} slots per second, one core")
    print(f"{'sites':>5}  {'how':<10} {'CPU ms':>7} {'late ms':>8} {'p99':>6}  step alone, sites")
    kinds = ("processes", "turns", "threads")
    for sites in options.sites:
        rounds = [[measured(options, kind, sites) for kind in kinds] for _ in range(ROUNDS)]
        for kind, (cpu, late, worst) in zip(kinds, np.median(rounds, axis=0), strict=True):
            fit = 1e3 * INTERVAL_S / cpu
            print(f"{sites:>5}  {kind:<10} {cpu:7.2f} {late:8.2f} {worst:6.1f}  {fit:.0f}")


if __name__ == "__main__":
    main()
