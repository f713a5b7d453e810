"""Costs of programs and verbs: CPU relative to a reference loop of the same run, and memory.

    python lab/benchmarks/budget.py            # fails where a limit of budget.toml is exceeded

    python lab/benchmarks/budget.py --only first

CPU is counted, not time on the clock, and divided by the CPU of a loop of plain Python and numpy
that runs in turns with what is measured: a busy or slow machine changes the ratio little. Imports
and verbs start in fresh interpreters. Programs are those of a site over TLS on loopback, whose five
cameras replay four simulated people at 25 slots per second. A first start is that of its edge with
an empty cache of compiled kernels: its CPU until its first pose, that of the processes that it
starts until everything is compiled, and the memory of all.
"""

from __future__ import annotations

import argparse
import json
import os
import pty
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import psutil

from e3pose.base.bounded import parse_toml
from e3pose.cli.app import VERBS
from e3pose.site.up import Program
from e3pose.wire.arrays import unpack
from e3pose.wire.site_messages import Poses
from live_site import Site, live_site, wait

LIMITS = Path(__file__).with_name("budget.toml")
# The command lines' modules, and what their verbs import when called.
PROGRAMS = {
    "edge": "e3pose.site.edge_program",
    "camera": "e3pose.site.camera_program",
    "view": "e3pose.site.web.program",
    "top": "e3pose.site.follow, e3pose.site.screen, e3pose.wire.network",
}
# Every interpreter says at its end how large it was. What its parent could ask for, `ru_maxrss`,
# counts the parent's own pages, which a child has before it starts its program.
PEAK = """
import atexit, os, re
def say_peak():
    with open("/proc/self/status") as status:
        os.write(2, re.search(r"VmHWM:\\s*(\\d+) kB", status.read())[1].encode())
atexit.register(say_peak)
"""
VERB = f"{PEAK}\nimport sys\nfrom e3pose.cli import main\nmain(sys.argv[1:])"


@dataclass(frozen=True)
class Cost:
    """Measured cost of one program or verb, and its limits.

    Attributes:
        name: of a program's import or run, or of a verb.
        loops: CPU, in runs of the reference loop; of a program, in each second.
        memory_mb: the most at once, or of a program the proportional set size.
        limit_loops: of the table; infinite where it has none.
        limit_mb: of the table.
    """

    name: str
    loops: float
    memory_mb: float
    limit_loops: float
    limit_mb: float

    def over(self) -> bool:
        return self.loops > self.limit_loops or self.memory_mb > self.limit_mb


def reference_s() -> float:
    """Return the CPU seconds of the reference loop: plain Python and small matrices."""
    import numpy as np

    matrix, sums = np.eye(17) + 0.01, 0.0
    begun_s = time.process_time()
    for number in range(100_000):
        sums += float((matrix @ matrix)[0, 0]) + len(str(number)) + sum(range(20))
    return time.process_time() - begun_s


def children_s() -> float:
    """Return the CPU seconds of all children that ended."""
    times = os.times()
    return times.children_user + times.children_system


def started(words: Sequence[str]) -> tuple[float, float]:
    """Return CPU seconds and largest memory in MB of a fresh interpreter that writes the latter."""
    before_s = children_s()
    ended = subprocess.run([sys.executable, *words], check=True, capture_output=True, text=True)
    return children_s() - before_s, int(ended.stderr) * 1024 / 1e6


def starts(runs: int) -> dict[str, tuple[float, float]]:
    """Return CPU in reference loops and MB of each import and each verb's help."""
    commands = {
        f"import of {name}": ["-c", f"{PEAK}\nimport {modules}"]
        for name, modules in PROGRAMS.items()
    }
    commands |= {f"verb {verb}": ["-c", VERB, verb, "--help"] for verb in VERBS}
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in commands}
    loops_s: list[float] = []
    for words in [*commands.values()][: len(PROGRAMS) + 1]:  # bytecode that all then share
        started(words)
    for _ in range(runs):
        for name, words in commands.items():
            loops_s.append(reference_s())
            found[name].append(started(words))
    unit_s = statistics.median(loops_s)
    return {
        name: (min(cpu_s for cpu_s, _ in each) / unit_s, max(mb for _, mb in each))
        for name, each in found.items()
    }


class FirstStart(threading.Thread):
    """Watches an edge and the processes that it starts.

    Attributes:
        peak_mb: the largest sum of their proportional set sizes.
        first: seconds, and CPU seconds of the edge, until the first pose.
    """

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.peak_mb, self.first, self.edge_s = 0.0, (0.0, 0.0), 0.0
        self.over = threading.Event()
        self.beside_s: dict[int, float] = {}  # CPU by process, also of those that ended

    def begin(self, program: Program) -> None:
        """Start to watch when the edge does."""
        if program.name == "edge":
            self._program, self._begun_s = program, time.monotonic()
            self.start()

    def posed(self, poses: Poses) -> None:
        """Note the first pose."""
        if not self.first[0] and len(unpack(poses.track_ids)):
            self.first = self.passed_s(), self.edge_s

    def passed_s(self) -> float:
        """Return the seconds since the edge was started."""
        return time.monotonic() - self._begun_s

    def run(self) -> None:
        """Look at all processes ten times a second."""
        while not self.over.wait(0.1):
            if self._program.process is None:
                continue
            with suppress(psutil.Error):
                edge = psutil.Process(self._program.process.pid)
                beside, self.edge_s = edge.children(recursive=True), _cpu_s([edge])
                self.beside_s |= {each.pid: _cpu_s([each]) for each in beside}
                sizes = (each.memory_full_info().pss / 1e6 for each in (edge, *beside))
                self.peak_mb = max(self.peak_mb, sum(sizes))


def first_start() -> dict[str, tuple[float, float]]:
    """Return CPU in reference loops and MB until the first pose, and until all is compiled."""
    watch, unit_s = FirstStart(), reference_s()
    with (
        tempfile.TemporaryDirectory(prefix="e3pose-") as cache,
        patch.dict(os.environ, NUMBA_CACHE_DIR=cache),
        live_site(change=watch.begin, on_poses=watch.posed, settle_s=0.0) as site,
    ):
        while site.follower.status is None or site.follower.status.compiling_s is not None:
            site.edge()  # raises if it has ended
            wait(0.2)
        watch.over.set()
        compiled_s, cpu_s = watch.passed_s(), sum(watch.beside_s.values())
    first_s, first_cpu_s = watch.first
    print(
        f"first pose after {first_s:.1f} s ({first_cpu_s:.1f} s of CPU), all compiled after "
        f"{compiled_s:.1f} s ({cpu_s:.1f} s of CPU beside), at most {watch.peak_mb:.0f} MB"
    )
    return {
        "first pose": (first_cpu_s / unit_s, watch.peak_mb),
        "first start": (cpu_s / unit_s, watch.peak_mb),
    }


@contextmanager
def top_of(site: Site) -> Iterator[psutil.Process]:
    """Run `e3pose top` on a terminal of its own."""
    ours, its = pty.openpty()

    def drain() -> None:
        with suppress(OSError):  # its end
            while os.read(ours, 65536):
                pass

    command = [sys.executable, "-m", "e3pose", "top", str(site.folder / "site.toml")]
    top = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=its, stderr=its)
    os.close(its)
    reader = threading.Thread(target=drain)
    reader.start()
    try:
        yield psutil.Process(top.pid)
    finally:
        top.terminate()
        top.wait()
        reader.join()
        os.close(ours)


def running(seconds: float) -> dict[str, tuple[float, float]]:
    """Return CPU in reference loops per second and MB of each program of a site."""
    with live_site(page=True) as site, top_of(site) as top:
        wait(3.0)  # until top shows the site
        groups = {"edge": [site.edge()], "camera": site.cameras(), "view": site.page()}
        groups["top"] = [top]
        before_s = {name: _cpu_s(group) for name, group in groups.items()}
        begun_s, loops_s = time.monotonic(), list[float]()
        while time.monotonic() < begun_s + seconds:
            loops_s.append(reference_s())
            wait(seconds / 10)
        passed_s = time.monotonic() - begun_s
        unit_s = statistics.median(loops_s) * passed_s
        return {
            f"running {name}": (
                (_cpu_s(group) - before_s[name]) / len(group) / unit_s,
                statistics.mean(each.memory_full_info().pss / 1e6 for each in group),
            )
            for name, group in groups.items()
        }


def _cpu_s(processes: list[psutil.Process]) -> float:
    return float(sum(times.user + times.system for times in (p.cpu_times() for p in processes)))


def costs(measured: dict[str, tuple[float, float]], limits: dict[str, Any]) -> list[Cost]:
    """Join what was measured with its limits: those of its name, or else of its kind."""
    found = []
    for name, (loops, memory_mb) in measured.items():
        limit = limits.get(name, limits.get(name.split()[0], {}))
        most = (float(limit.get(key, "inf")) for key in ("loops", "memory_mb"))
        found.append(Cost(name, loops, memory_mb, *most))
    return found


def table(rows: Sequence[Cost]) -> str:
    """Return the costs as a table, what is over its limit marked."""
    lines = [f"{'':<30} {'loops':>7} {'limit':>7} {'MB':>7} {'limit':>7}"]
    for row in rows:
        line = f"{row.name:<30} {row.loops:7.2f} {row.limit_loops:7.2f} "
        line += f"{row.memory_mb:7.0f} {row.limit_mb:7.0f}"
        lines.append(line + ("  OVER" if row.over() else ""))
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0, help="that programs are watched")
    parser.add_argument("--runs", type=int, default=1, help="fresh interpreters of each start")
    parser.add_argument("--limits", type=Path, default=LIMITS)
    parser.add_argument("--only", choices=("starts", "running", "first"))
    parser.add_argument("--json", type=Path, help="write the figures here too")
    options = parser.parse_args()
    limits = parse_toml(options.limits.read_text(), str(options.limits))
    parts: dict[str, Callable[[], dict[str, tuple[float, float]]]] = {
        "starts": lambda: starts(options.runs),
        "running": lambda: running(options.seconds),
        "first": first_start,
    }
    chosen = parts if options.only is None else (options.only,)
    measured = {name: cost for part in chosen for name, cost in parts[part]().items()}
    rows = costs(measured, limits)
    print(table(rows))
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")
    over = [row.name for row in rows if row.over()]
    print(f"over the limit: {', '.join(over)}" if over else "within all limits")
    return 1 if over else 0


if __name__ == "__main__":
    sys.exit(main())
