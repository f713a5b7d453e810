"""Measure what a person waits for before anything happens: the import and the help."""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

TARGET_S = 0.3  # for `import e3pose`; the rest has no target
HEAVY = ("numba", "cv2", "onnxruntime", "torch", "scipy", "av", "pyarrow", "plotly")
COMMANDS = {
    "python -c pass": ("-c", "pass"),
    "import e3pose": ("-c", "import e3pose"),
    "import e3pose.model.camera": ("-c", "import e3pose.model.camera"),
    "e3pose --help": ("-m", "e3pose", "--help"),
    "e3pose detect --help": ("-m", "e3pose", "detect", "--help"),
    "e3pose replay --help": ("-m", "e3pose", "replay", "--help"),
}


def seconds(words: Sequence[str]) -> float:
    """Return how long a fresh interpreter takes to run `words` and end."""
    start = time.perf_counter()
    subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def heavy_modules() -> list[str]:
    """Return the heavy modules that `import e3pose` brought in."""
    code = f"import e3pose, sys; print(*(m for m in {HEAVY!r} if m in sys.modules))"
    output = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout
    return output.split()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=7, help="fresh interpreters a command")
    parser.add_argument("--json", type=Path, help="write the figures here too")
    options = parser.parse_args()
    for words in COMMANDS.values():
        seconds(words)  # compiles and pages in what the others then share
    # One of each in turn, so that a busy moment of the machine hits all alike.
    times: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for _ in range(options.runs):
        for name, words in COMMANDS.items():
            times[name].append(seconds(words))
    rows = {
        name: {"median_s": statistics.median(runs), "worst_s": max(runs)}
        for name, runs in times.items()
    }
    print(f"{'start of a fresh process':<24}  median    worst  ({options.runs} runs)")
    for name, row in rows.items():
        print(f"{name:<24}  {row['median_s']:5.3f} s  {row['worst_s']:5.3f} s")
    heavy = heavy_modules()
    quick = rows["import e3pose"]["median_s"] < TARGET_S
    print(
        f"import e3pose: {'under' if quick else 'NOT under'} {TARGET_S} s; "
        f"heavy modules it loads: {', '.join(heavy) or 'none'}"
    )
    if options.json:
        options.json.write_text(json.dumps({"rows": rows, "heavy": heavy}, indent=2) + "\n")


if __name__ == "__main__":
    main()
