"""What makes identities change: people who left, tracks that were lost, people taken for others.

python lab/benchmarks/identities.py --scenes one-sided,poor-view,ring --seeds 20

Counts changes of the number that people are shown with, per minute that a person is there:
returned, who had left the scene in between; swapped, who got the number of somebody else there;
lost, the rest, who were there all the time and whose track ended.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

from e3pose_lab.reproduce.identities import KINDS, changes

FIRST_SEED = 1000
SECONDS, FPS = 16.0, 12.5


def measure(scene: str, seeds: int, policy: str, count: float) -> tuple[Counter[str], float]:
    """Return the changes over all seeds, and the minutes that people were there."""
    from e3pose.evaluate.replay import ReplaySettings, replay
    from e3pose.simulate import SCENES, SceneSettings, simulate

    total: Counter[str] = Counter()
    minutes = 0.0
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        fps = min(FPS, SCENES[scene].fps)
        recording = simulate(SceneSettings(scene=scene, seconds=SECONDS, fps=fps), seed)
        assert recording.truth is not None
        settings = ReplaySettings(
            pipeline="memory", policy=policy, num_selected=count, seed=seed % 1000,
            phase=seed % 1000,
        )  # fmt: skip
        total += changes(recording, list(replay(recording, settings)))
        there = np.isfinite(recording.truth.joints_m[..., 0, 0]).sum()
        minutes += float(there) * recording.interval_s / 60
    return total, minutes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenes", default="one-sided,poor-view,ring")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--policies", default="round-robin,information")
    parser.add_argument("--cameras", type=float, default=2)
    options = parser.parse_args()
    print(f"| scene | policy | changes a person-minute | {' | '.join(KINDS)} |")
    print("|---|---|---|---|---|---|")
    for scene in options.scenes.split(","):
        for policy in options.policies.split(","):
            found, minutes = measure(scene, options.seeds, policy, options.cameras)
            rates = [f"{found[kind] / minutes:.2f}" for kind in KINDS]
            total = f"{found.total() / minutes:.2f}"
            print(f"| `{scene}` | {policy} | {total} | {' | '.join(rates)} |", flush=True)


if __name__ == "__main__":
    main()
