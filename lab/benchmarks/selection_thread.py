"""Whether camera selection in a thread of its own, as in the paper's edge server, is faster.

    python lab/benchmarks/selection_thread.py RECORDING

The paper's edge has a thread that fuses and one that selects, with a queue between them. Here one
thread does both, and publishes poses before it selects. This runs the same work of the pipeline
`paper` both ways, as fast as it goes, and prints slots per second of each, by turns. Where other
programs run, only processor time means anything: two threads get more of a busy machine than one.
"""

from __future__ import annotations

import argparse
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROUNDS = 15


def work(source: Any) -> tuple[Callable[[int], Any], Callable[[Any], None]]:
    """Return what fuses a slot, and what predicts and selects from what the first returns."""
    from dataclasses import replace

    from e3pose.evaluate.replay import ReplaySettings, selected_views
    from e3pose.pipeline import initial_state
    from e3pose.select.occlusion import expected_views
    from e3pose.select.policies.base import Situation
    from e3pose.settings.parts import make_pipeline

    pipeline = make_pipeline(source, ReplaySettings(pipeline="paper"))
    num_cameras = len(source.rig)
    everyone = np.ones(num_cameras, dtype=bool)
    views = [selected_views(source, slot, everyone) for slot in range(source.num_slots)]
    memory = [initial_state(pipeline).memory]
    blank = Situation(
        slot=0, interval_s=source.interval_s, online=everyone, occlusion=np.zeros(num_cameras),
        own_occlusion=np.zeros(num_cameras), unseen_slots=np.ones(num_cameras, dtype=np.int64),
        visibility=np.zeros((num_cameras, 0)), deficit=np.zeros(num_cameras),
        budget=pipeline.queue.budget, price=np.zeros(num_cameras), spread=0.1,
    )  # fmt: skip

    def fuse(slot: int) -> Any:
        if slot == 0:  # a recording that begins again is another one
            memory[0] = initial_state(pipeline).memory
        time_s = slot * source.interval_s
        memory[0], people = pipeline.estimator.estimate(memory[0], views[slot], time_s, float)
        return people.history_m

    def choose(history_m: Any) -> None:
        joints_m = pipeline.predictor.predict(history_m, source.interval_s, 1).joints_m[0]
        occlusion, visibility = expected_views(source.rig, joints_m)
        pipeline.policy.select(replace(blank, occlusion=occlusion, visibility=visibility))

    return fuse, choose


def in_one_thread(fuse: Callable[[int], Any], choose: Callable[[Any], None], slots: int) -> float:
    """Return the seconds that all slots take."""
    began = time.perf_counter()
    for slot in range(slots):
        choose(fuse(slot))
    return time.perf_counter() - began


def in_two_threads(fuse: Callable[[int], Any], choose: Callable[[Any], None], slots: int) -> float:
    """Return the seconds that all slots take with a thread that selects."""
    waiting: queue.Queue[Any] = queue.Queue(maxsize=1)

    def select() -> None:
        while (history_m := waiting.get()) is not None:
            choose(history_m)

    thread = threading.Thread(target=select)
    began = time.perf_counter()
    thread.start()
    for slot in range(slots):
        waiting.put(fuse(slot))
    waiting.put(None)
    thread.join()
    return time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("recording", type=Path)
    options = parser.parse_args()
    from e3pose.recording import load_recording

    source = load_recording(options.recording)
    fuse, choose = work(source)
    in_one_thread(fuse, choose, 20)  # compiles
    began = time.thread_time()
    histories = [fuse(slot) for slot in range(source.num_slots)]
    fusing = time.thread_time() - began
    began = time.thread_time()
    for history_m in histories:
        choose(history_m)
    choosing = time.thread_time() - began
    print(f"processor time: fuse {1000 * fusing / source.num_slots:.3f} ms per slot, "
          f"predict and select {1000 * choosing / source.num_slots:.3f} ms; two threads can be "
          f"{(fusing + choosing) / max(fusing, choosing):.2f} times as fast at most")  # fmt: skip
    rates: dict[str, list[float]] = {"one thread": [], "two threads": []}
    used: dict[str, list[float]] = {"one thread": [], "two threads": []}
    for _ in range(ROUNDS):
        for name, run in (("one thread", in_one_thread), ("two threads", in_two_threads)):
            began = time.process_time()
            rates[name].append(source.num_slots / run(fuse, choose, source.num_slots))
            used[name].append(1000 * (time.process_time() - began) / source.num_slots)
    for name, values in rates.items():
        print(f"{name}: {np.median(values):.0f} slots per second, "
              f"{np.median(used[name]):.3f} ms of processor time a slot")  # fmt: skip
    ratio = np.median(np.array(rates["two threads"]) / np.array(rates["one thread"]))
    cost = np.median(np.array(used["two threads"]) / np.array(used["one thread"]))
    print(f"two threads over one: {ratio:.2f} slots per second, {cost:.2f} processor time")


if __name__ == "__main__":
    main()
