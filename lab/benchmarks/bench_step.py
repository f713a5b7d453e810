"""Measure what a slot costs: CPU of `pipeline.step` by stage, and as a ratio to an earlier commit.

    python lab/benchmarks/bench_step.py
    python lab/benchmarks/bench_step.py --against HEAD~1
    python lab/benchmarks/bench_step.py --against none
    python lab/benchmarks/bench_step.py --cold 64       # write so many MB before every step
    python lab/benchmarks/bench_step.py --skeleton coco133   # 4 cameras, all active, 2 people

The loop as a site has it: the filter, steered by the learned predictor, and the policy
`information` four slots ahead. The other commit is checked out beside this one and measured in
turns with it, each time in a process of its own, so that a busy machine slows both alike.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

SIZES = ((5, 4, 2), (12, 8, 4))  # cameras, people, cameras per slot
WHOLE = (4, 2, 4)  # of `--skeleton`
TARGETS_MS = {"5x4": 0.6, "12x8": 1.5}
BEFORE = "ce30be4"  # every stage but the filter was numpy, and the network ran in ONNX Runtime
ROUNDS = 3
LEAD, FPS, SECONDS = 4, 25.0, 8.0
STAGES = ("estimate", "predict", "occlusion", "select", "rest")
ROOT = Path(__file__).resolve().parents[2]

Costs = dict[str, dict[str, float]]  # size -> stage -> milliseconds


def measure(
    cold_mb: int = 0, sizes: Sequence[tuple[int, int, int]] = SIZES, skeleton: str = "coco17"
) -> Costs:
    """Return the median CPU of each stage, and of the whole step, in this process.

    Args:
        cold_mb: so much is written before every step, as other programs do beside a live edge.
        sizes: cameras, people, cameras per slot.
        skeleton: of the keypoints.
    """
    from e3pose.evaluate.replay import ReplaySettings, make_pipeline
    from e3pose.pipeline import initial_state, step
    from e3pose.simulate import SceneSettings, simulate
    from e3pose.simulate.feet import with_skeleton

    costs: Costs = {}
    other = np.zeros(cold_mb * 2**17)
    for cameras, people, count in sizes:
        scene = SceneSettings("ring", people=people, seconds=SECONDS, fps=FPS, cameras=cameras)
        recording = with_skeleton(simulate(scene, seed=701), skeleton, seed=701)
        settings = ReplaySettings(num_selected=count, lead_slots=LEAD)
        pipeline = make_pipeline(recording, settings, time.process_time)
        online = np.ones(cameras, dtype=bool)
        rows: list[list[float]] = []
        for turn in range(3):
            state = initial_state(pipeline)
            for slot in range(recording.num_slots):
                ordered = np.flatnonzero(state.selections[0]).tolist()
                seen = {camera: recording.view(slot, camera) for camera in ordered}
                views = {camera: view for camera, view in seen.items() if view is not None}
                other += 1.0
                start = time.process_time()
                state, record = step(pipeline, state, views, online)
                whole = time.process_time() - start
                if turn and slot > settings.warmup_slots:  # the first turn compiles
                    known = [record.stage_s[stage] for stage in STAGES[:-1]]
                    rows.append([*known, whole - sum(known), whole])
        medians = 1e3 * np.median(rows, axis=0)
        costs[f"{cameras}x{people}"] = dict(zip((*STAGES, "step"), medians.tolist(), strict=True))
    return costs


def in_process(root: Path, cold_mb: int = 0) -> Costs:
    """Run `measure` on the sources below `root`, in a process of its own."""
    code = f"import json, bench_step; print(json.dumps(bench_step.measure({cold_mb})))"
    paths = (root / "src", ROOT / "lab" / "benchmarks")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths))}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    costs: Costs = json.loads(done.stdout.splitlines()[-1])
    return costs


@contextmanager
def checked_out(commit: str) -> Iterator[Path | None]:
    """Yield a folder with the sources of a commit; None where there is none."""
    with tempfile.TemporaryDirectory(prefix="e3pose-") as folder:
        archive = subprocess.run(
            ["git", "archive", commit, "src"], cwd=ROOT, capture_output=True, check=False
        )
        if archive.returncode:
            yield None
            return
        subprocess.run(["tar", "-x", "-C", folder], input=archive.stdout, check=True)
        yield Path(folder)


def medians(found: list[Costs]) -> Costs:
    """Return the medians of several rounds."""
    return {
        size: {stage: float(np.median([one[size][stage] for one in found])) for stage in stages}
        for size, stages in found[0].items()
    }


def print_costs(now: Costs, before: Costs | None, commit: str) -> None:
    """Print a row per stage: milliseconds, share of the step, ratio to before."""
    for size, stages in now.items():
        print(f"{size} cameras x people: CPU of a slot, share of the step, ratio to {commit}")
        for stage, spent in stages.items():
            line = f"  {stage:<10} {spent:6.3f} ms  {100 * spent / stages['step']:4.0f} %"
            if before is not None:
                line += f"  {spent / before[size][stage]:5.2f}"
            if stage == "step":
                line += f"  target {TARGETS_MS[size]} ms"
            print(line)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", default=BEFORE, help="a commit to compare with, or none")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--cold", type=int, default=0, metavar="MB", help="empty the caches")
    parser.add_argument("--json", type=Path, help="write the figures here too")
    parser.add_argument("--skeleton", help="measure a skeleton alone")
    options = parser.parse_args()
    if options.skeleton:
        for stage, spent in measure(0, (WHOLE,), options.skeleton)["4x2"].items():
            print(f"{options.skeleton} {stage:<10} {spent:6.3f} ms")
        return
    with checked_out(options.against) as other:
        if other is None and options.against != "none":
            print(f"commit {options.against} is not in this checkout: no ratios")
        for root in (ROOT, other):
            if root is not None:  # a process that compiles is slower afterwards as well
                in_process(root)
        rounds: list[tuple[Costs, Costs | None]] = []
        for _ in range(options.rounds):
            mine = in_process(ROOT, options.cold)
            rounds.append((mine, None if other is None else in_process(other, options.cold)))
    now = medians([mine for mine, _ in rounds])
    earlier = [theirs for _, theirs in rounds if theirs is not None]
    before = medians(earlier) if earlier else None
    print_costs(now, before, options.against)
    if options.json:
        options.json.write_text(json.dumps({"now": now, "before": before}, indent=2) + "\n")


if __name__ == "__main__":
    main()
