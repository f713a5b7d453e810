"""Run a verb of e3pose, or a script that runs one, with clocks that can be moved while it runs.

    python lab/benchmarks/moved_clock.py OFFSETS edge site.toml
    python lab/benchmarks/moved_clock.py OFFSETS script.py site.toml

OFFSETS is a file with two numbers, seconds: what is added to the steady clock of the program (the
project's `WallClock`), and to the system's clock as Python reads it (`time.time`, `time.time_ns`).
"""

from __future__ import annotations

import runpy
import sys
import time
from pathlib import Path

from e3pose.base.clock import WallClock
from e3pose.cli import main

_time_s, _time_ns = time.time, time.time_ns


def offset_ns(path: Path, which: int) -> int:
    """Return an offset of a file; 0 while it is being written."""
    try:
        return round(float(path.read_text().split()[which]) * 1e9)
    except (OSError, ValueError, IndexError):
        return 0


def move(path: Path) -> None:
    """Add the offsets of a file to the clocks of this process."""

    def steady_ns(self: WallClock) -> int:
        return self.origin_ns + time.monotonic_ns() + offset_ns(path, 0)

    WallClock.now_ns = steady_ns  # type: ignore[method-assign]
    time.time = lambda: _time_s() + offset_ns(path, 1) / 1e9
    time.time_ns = lambda: _time_ns() + offset_ns(path, 1)


if __name__ == "__main__":
    move(Path(sys.argv.pop(1)))
    if sys.argv[1].endswith(".py"):
        sys.argv.pop(0)
        runpy.run_path(sys.argv[0], run_name="__main__")
    else:
        main(sys.argv[1:])
