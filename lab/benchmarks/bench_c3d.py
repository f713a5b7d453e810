"""Seconds and memory of a C3D export: own frames behind ezc3d's header, and ezc3d alone.

    python lab/benchmarks/bench_c3d.py --minutes 5 --people 4

Each runs in a process of its own; the content of both is compared through ezc3d's reader.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from e3pose.model.skeleton import COCO17
from e3pose.model.take import Take, motion_of
from e3pose.output.exports import export

FPS = 25.0


def take(minutes: float, people: int) -> Take:
    """Return people who are there all the time, a tenth of their joints missing or predicted."""
    rng, frames = np.random.default_rng(0), round(minutes * 60 * FPS)
    motions = []
    for track in range(people):
        joints_m = rng.normal(size=(frames, 17, 3))
        joints_m[rng.random((frames, 17)) < 0.1] = np.nan
        measured = rng.random((frames, 17)) > 0.1
        sigma_m = rng.uniform(0.002, 0.06, (frames, 17))
        motions.append(
            motion_of(track, np.arange(frames), joints_m, sigma_m, np.ones((frames, 17)), measured)
        )
    return Take("bench", COCO17, 1 / FPS, tuple(motions))


def by_ezc3d(made: Take, dest: Path) -> None:
    """Write places and residuals with ezc3d alone."""
    import ezc3d

    joints_m, _, _ = made.dense()
    frames, people = joints_m.shape[:2]
    points = np.ones((4, people * 17, frames))
    points[:3] = 1000 * np.nan_to_num(joints_m).transpose(3, 1, 2, 0).reshape(3, -1, frames)
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [FPS]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["LABELS"]["value"] = [f"p{n}" for n in range(people * 17)]
    file["data"]["points"] = points
    file.write(str(dest))


def one(which: str, minutes: float, people: int, dest: Path) -> None:
    """Write once and print seconds, and the megabytes that it took at most beyond the take."""
    made = take(minutes, people)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begun_s = time.perf_counter()
    if which == "ezc3d":
        by_ezc3d(made, dest)
    else:
        list(export(made, dest, "c3d"))
    took_s = time.perf_counter() - begun_s
    more_mb = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    print(f"{which:8} {took_s:7.2f} s {more_mb:8.0f} MB more memory at most")


def main() -> None:
    """Run both and compare them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--people", type=int, default=4)
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        one(asked.one[0], asked.minutes, asked.people, Path(asked.one[1]))
        return
    with tempfile.TemporaryDirectory(prefix="e3pose-c3d-") as name:
        files = {which: Path(name) / f"{which}.c3d" for which in ("ezc3d", "e3pose")}
        for which, dest in files.items():
            size = ["--minutes", str(asked.minutes), "--people", str(asked.people)]
            command = [sys.executable, __file__, *size, "--one", which, str(dest)]
            subprocess.run(command, check=True)
        import ezc3d

        left, right = (ezc3d.c3d(str(file))["data"]["points"][:3] for file in files.values())
        same = np.array_equal(np.nan_to_num(left), np.nan_to_num(right))
        print(f"places by ezc3d's reader: {'equal to the bit' if same else 'DIFFERENT'}")


if __name__ == "__main__":
    main()
