"""What the policy `independent` finds by its threshold, and by how long it trusts old boxes.

    python benchmarks/independent_sweep.py

The paper states neither. Simulated people in rings of five cameras, pipeline `paper`; recall and
precision at 200 mm as their harmonic mean in percent, MPJPE in mm and cameras per slot.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

SCENES = ("ring", "crossing", "meeting", "pillar")
SEEDS = (701, 702)
LIMITS = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3)
REFRESH_S = (0.25, 0.5, 1.0, 2.0)
SECONDS, FPS = 12.0, 25.0
FOUND_M = 0.2


def figures(recording: Any, policy: Any) -> tuple[float, float, float]:
    """Return the harmonic mean in percent, MPJPE in mm and cameras per slot."""
    from e3pose.evaluate.metrics import candidates, first_matches, mpjpe_mm
    from e3pose.evaluate.replay import ReplaySettings, replay

    settings = ReplaySettings(pipeline="paper", num_selected=3)
    records = list(replay(recording, settings, policy=policy))
    people = [record.poses.joints_m for record in records]
    scores = [record.poses.scores.mean(axis=-1) for record in records]
    found = candidates(people, scores, recording.truth.joints_m)
    right = float(first_matches(found, FOUND_M).sum())
    harmonic = 2 * right / (found.num_truths + len(found.errors_m))
    cameras = float(np.mean([record.selected.sum() for record in records]))
    return 100 * harmonic, mpjpe_mm(found) or np.nan, cameras


def sweep(seeds: Sequence[int]) -> NDArray[np.float64]:
    """Return `(num_recordings, limits, refreshes, 3)` figures."""
    from e3pose.select.policies.independent import Independent
    from e3pose.simulate import SceneSettings, simulate

    rows = []
    for scene in SCENES:
        for seed in seeds:
            recording = simulate(SceneSettings(scene=scene, seconds=SECONDS, fps=FPS), seed)
            rows.append(
                [[figures(recording, Independent(x, s)) for s in REFRESH_S] for x in LIMITS]
            )
            print(f"{scene} {seed}", np.round(rows[-1], 1).tolist(), flush=True)
    return np.array(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    means = sweep(parser.parse_args().seeds).mean(axis=0)
    print(f"| limit | {' | '.join(f'{s:g} s' for s in REFRESH_S)} |")
    print("|---" * (len(REFRESH_S) + 1) + "|")
    for limit, row in zip(LIMITS, means, strict=True):
        cells = [f"{h:.1f} %, {error:.1f} mm, {count:.2f}" for h, error, count in row]
        print(f"| {limit:g} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
