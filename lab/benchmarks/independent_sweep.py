"""What the policy `independent` finds by its threshold, and by how long it trusts old boxes.

    python lab/benchmarks/independent_sweep.py --mocap cmu_mocap_train_30fps.npz
    python lab/benchmarks/independent_sweep.py --shelf RECORDING

The paper states neither. Simulated people and motion capture in rings of five cameras, pipeline
`paper`; recall and precision at 200 mm as their harmonic mean in percent and cameras per slot. With
`--shelf`, PCP in percent instead.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

SCENES = ("ring", "crossing", "meeting", "pillar")
SEEDS = (701, 702)
LIMITS = (0.0, 0.02, 0.05, 0.08, 0.1, 0.15, 0.2, 0.3)
REFRESH_S = (0.25, 0.5, 1.0, 2.0)
SECONDS, FPS = 12.0, 25.0
FOUND_M = 0.2


def figures(recording: Any, policy: Any) -> tuple[float, float]:
    """Return PCP where it is known, else the harmonic mean, in percent; and cameras per slot."""
    from e3pose.evaluate.metrics import candidates, first_matches
    from e3pose.evaluate.replay import ReplaySettings, replay
    from e3pose.evaluate.summary import accuracy

    settings = ReplaySettings(pipeline="paper", num_selected=3)
    records = list(replay(recording, settings, policy=policy))
    cameras = float(np.mean([record.selected.sum() for record in records]))
    pcp = accuracy(recording, records).pcp
    if pcp is not None:
        return pcp.actors["average"], cameras
    people = [record.poses.joints_m for record in records]
    scores = [record.poses.scores.mean(axis=-1) for record in records]
    found = candidates(people, scores, recording.truth.joints_m)
    right = float(first_matches(found, FOUND_M).sum())
    return 100 * 2 * right / (found.num_truths + len(found.errors_m)), cameras


def recordings(options: argparse.Namespace) -> Iterator[tuple[str, Any]]:
    """Yield kinds and recordings."""
    from e3pose.recording import load_recording
    from e3pose.simulate import SceneSettings, simulate
    from quality_weight import CROWDS, crowd

    if options.shelf:
        yield "Shelf", load_recording(options.shelf)
        return
    for scene in SCENES:
        for seed in options.seeds:
            yield "simulated", simulate(SceneSettings(scene=scene, seconds=SECONDS, fps=FPS), seed)
    for number in range(len(CROWDS) if options.mocap else 0):
        yield "motion capture", crowd(options.mocap, number)


def main() -> None:
    """Measure and print one table for each kind."""
    from e3pose.select.policies.independent import Independent

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--mocap", type=Path)
    parser.add_argument("--shelf", type=Path)
    parser.add_argument("--queue", action="store_true", help="keep cameras within their budgets")
    options = parser.parse_args()
    tables: dict[str, list[Any]] = {}
    for kind, recording in recordings(options):
        tables.setdefault(kind, []).append(
            [
                [figures(recording, Independent(limit, s, options.queue)) for s in REFRESH_S]
                for limit in LIMITS
            ]
        )
    for kind, rows in tables.items():
        print(f"\n| {kind} | {' | '.join(f'{s:g} s' for s in REFRESH_S)} |")
        print("|---" * (len(REFRESH_S) + 1) + "|")
        for limit, row in zip(LIMITS, np.mean(rows, axis=0), strict=True):
            cells = [f"{share:.1f} %, {count:.2f}" for share, count in row]
            print(f"| {limit:g} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
