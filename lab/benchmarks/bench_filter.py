"""Measure the filter's step: predict, associate, update, who exists, births; from Python.

The compiled step is timed over a sequence that is run again and again, the numpy reference over the
same slots of the same sequence, and both have to find the same. Without `--shared` (or
E3POSE_SHARED) the people are made up; they are of the same kind.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from bench_fuse import Workload, make_workload, workloads
from e3pose.base.arrays import Floats
from e3pose.estimate.filter import Belief, Estimate, Model
from e3pose.estimate.filter.step import StepKernel
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from reference import step

SIMULATED = load_noise("simulated")

Slots = list[dict[int, Poses2D]]
Step = Callable[[Model, Belief, Mapping[int, Poses2D], float], tuple[Belief, Estimate]]

SIZES = ((5, 4), (5, 8), (12, 8), (28, 8))
DISTORTED = ((5, 4),)
# Median milliseconds per slot from Python.
TARGETS_MS = {"5x4": 0.5, "12x8": 2.5}
INTERVAL_S = 1 / 25
REFERENCE_SLOTS = 40


def slots_of(bench: Workload) -> Slots:
    """Return the views of all slots, as a pipeline is given them."""
    slots: Slots = []
    for keypoints, scores, counts in zip(
        bench.keypoints_px, bench.scores, bench.counts, strict=True
    ):
        slots.append(
            {
                camera: Poses2D(keypoints[camera, :count], scores[camera, :count])
                for camera, count in enumerate(counts.tolist())
            }
        )
    return slots


def run(advance: Step, model: Model, slots: Slots) -> tuple[list[Estimate], list[float]]:
    """Return the people of each slot of a sequence, and the seconds that each took."""
    belief, found, times_s = Belief.empty(model), [], []
    for slot, views in enumerate(slots):
        start = time.perf_counter()
        belief, estimate = advance(model, belief, views, slot * INTERVAL_S)
        times_s.append(time.perf_counter() - start)
        found.append(estimate)
    return found, times_s


def error_mm(found: list[Estimate], truth_m: Floats) -> float:
    """Return the mean distance of the people found to the nearest true ones, in millimetres."""
    errors = [
        np.linalg.norm(e.joints_m[:, None] - truth[None], axis=-1).mean(axis=-1).min(axis=1)
        for e, truth in zip(found, truth_m, strict=False)
    ]
    return 1e3 * float(np.nanmean(np.concatenate(errors)))


def measure(bench: Workload, kernel: StepKernel, seconds: float) -> dict[str, float]:
    model, slots = Model(bench.rig, COCO17, SIMULATED), slots_of(bench)
    found, _ = run(kernel, model, slots)
    times_s: list[float] = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        times_s += run(kernel, model, slots)[1]
    expected, reference_s = run(step, model, slots[:REFERENCE_SLOTS])
    worst = 0.0
    for a, b in zip(found, expected, strict=False):
        if a.track_ids.tolist() != b.track_ids.tolist():
            raise SystemExit("the compiled step and the reference see different people")
        worst = max(worst, float(np.nanmax(np.abs(a.joints_m - b.joints_m), initial=0.0)))
    median = float(np.median(times_s))
    reference = float(np.median(reference_s))
    return {
        "median_ms": 1e3 * median,
        "p99_ms": 1e3 * float(np.quantile(times_s, 0.99)),
        "reference_ms": 1e3 * reference,
        "speedup": reference / median,
        "difference_m": worst,
        "people": float(np.median([len(estimate) for estimate in found])),
        "error_mm": error_mm(found[len(found) // 2 :], bench.truth_m[len(found) // 2 :]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shared", default=os.environ.get("E3POSE_SHARED"))
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--seconds", type=float, default=2.0, help="of timing for each workload")
    options = parser.parse_args()
    start = time.perf_counter()
    kernel = StepKernel()
    kernel.warm_up(Model(make_workload(2, 1, 1).rig, COCO17, SIMULATED))
    warm_s = time.perf_counter() - start
    print("the filter's whole step from Python, one thread")
    print("people: " + ("workloads of --shared" if options.shared else "made up"))
    print(f"ready after {warm_s:.1f} s: compiled, or loaded where it had been compiled before")
    print("cameras x people  median ms   p99 ms  reference ms  ratio  error mm  difference m")
    rows: dict[str, dict[str, float]] = {"warm_up": {"seconds": warm_s}}
    for title, one in workloads(SIZES, DISTORTED, options.shared):
        rows[title] = row = measure(one, kernel, options.seconds)
        missed = row["median_ms"] > TARGETS_MS.get(title, np.inf)
        print(
            f"{title:>16}  {row['median_ms']:9.4f}  {row['p99_ms']:7.4f}  "
            f"{row['reference_ms']:12.2f}  {row['speedup']:5.0f}  {row['error_mm']:8.1f}  "
            f"{row['difference_m']:12.0e}"
            + (f"  misses its target of {TARGETS_MS[title]} ms" if missed else "")
        )
    print(f"load of the machine: {os.getloadavg()[0]:.1f}; other work shows in the p99")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
