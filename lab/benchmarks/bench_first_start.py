"""Measure the first start on a machine: seconds, CPU and memory until all kernels are compiled.

    python lab/benchmarks/bench_first_start.py
    python lab/benchmarks/bench_first_start.py --kernels 20      # what each kernel costs, too
    python lab/benchmarks/bench_first_start.py --against HEAD~1  # and as ratios to a commit

An empty cache, in a process of its own: what an edge with the default loop does before its first
slot. CPU and memory count all its processes.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from bench_step import ROOT, checked_out


def measure(kernels: bool) -> dict[str, Any]:
    """Return what a first start costs in this process and those that it starts.

    Args:
        kernels: also time each function that this process compiles; helpers are not seen.
    """
    from numba.core import event

    rows: list[tuple[str, float, float]] = []  # name, CPU with what it calls, CPU without
    stack: list[list[float]] = []

    class Timer(event.Listener):  # type: ignore[misc]  # untyped
        def on_start(self, event: Any) -> None:
            stack.append([time.process_time(), 0.0])

        def on_end(self, event: Any) -> None:
            begun_s, inside_s = stack.pop()
            whole_s = time.process_time() - begun_s
            if stack:
                stack[-1][1] += whole_s
            function = event.data["dispatcher"].py_func
            rows.append((f"{function.__module__}.{function.__name__}", whole_s, whole_s - inside_s))

    if kernels:
        event.register("numba:compile", Timer())
    begun_s = time.monotonic()
    from e3pose.edge.precompile import warm_up
    from e3pose.evaluate.replay import ReplaySettings, make_pipeline
    from e3pose.simulate import SceneSettings, simulate

    scene = simulate(SceneSettings(people=2, seconds=0.5, cameras=4), 0)
    warm_up(
        make_pipeline(scene, ReplaySettings(num_selected=2, lead_slots=4)), scene.skeleton.joints
    )
    taken_s = time.monotonic() - begun_s
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return {
        "seconds": taken_s,
        "cpu_s": sum(one.ru_utime + one.ru_stime for one in used),
        "mb": sum(one.ru_maxrss for one in used) / 1024,
        "rows": sorted(rows, key=lambda row: -row[2]),
    }


def first_start(root: Path, kernels: bool) -> dict[str, Any]:
    """Return what `measure` finds of the sources below `root`, with an empty cache."""
    code = f"import json, bench_first_start as b; print(json.dumps(b.measure({kernels})))"
    paths = (root / "src", ROOT / "lab" / "benchmarks")
    with tempfile.TemporaryDirectory(prefix="e3pose-") as cache:
        done = subprocess.run(
            [sys.executable, "-c", code],
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(map(str, paths)),
                "NUMBA_CACHE_DIR": cache,
            },
            check=True,
            stdout=subprocess.PIPE,
            text=True,
        )
        found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
        files = [path for path in Path(cache).rglob("*.nbc")]
        found["files"], found["disk_mb"] = len(files), sum(f.stat().st_size for f in files) / 1e6
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", help="a commit to compare with")
    parser.add_argument("--kernels", type=int, default=0, help="list so many functions")
    options = parser.parse_args()
    mine = first_start(ROOT, bool(options.kernels))
    before = None
    if options.against:
        with checked_out(options.against) as other:
            if other is None:
                sys.exit(f"commit {options.against} is not in this checkout")
            before = first_start(other, False)
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    for name, unit in (
        ("seconds", "s"), ("cpu_s", "s of CPU"), ("mb", "MB of memory, at most"),
        ("files", "files in the cache"), ("disk_mb", "MB in the cache"),
    ):  # fmt: skip
        ratio = (
            "" if before is None else f"  was {before[name]:.0f}: {mine[name] / before[name]:.2f}"
        )
        print(f"{mine[name]:6.0f} {unit}{ratio}")
    for name, whole_s, own_s in mine["rows"][: options.kernels]:
        print(f"{own_s:7.2f} s, {whole_s:7.2f} with what it calls  {name}")


if __name__ == "__main__":
    main()
