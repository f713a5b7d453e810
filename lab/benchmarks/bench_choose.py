"""What deciding ahead costs: time per slot by stage and lead, as ratios to lead 1 in the same run.

python lab/benchmarks/bench_choose.py

Leads take turns within one process, so that a busy machine slows all of them alike.
"""

from __future__ import annotations

import numpy as np

from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.simulate import SceneSettings, simulate

SIZES = ((5, 4, 2), (12, 8, 4))  # cameras, people, cameras per slot
LEADS = (1, 2, 4, 6)
ROUNDS = 5
SECONDS, FPS = 4.0, 25.0


def main() -> None:
    for cameras, people, count in SIZES:
        scene = SceneSettings("ring", people=people, seconds=SECONDS, fps=FPS, cameras=cameras)
        recording = simulate(scene, seed=3)
        times: dict[tuple[int, str], list[float]] = {}
        for turn in range(ROUNDS + 1):
            for lead in LEADS:
                settings = ReplaySettings(num_selected=count, lead_slots=lead)
                for record in replay(recording, settings):
                    for stage, seconds in record.stage_s.items():
                        if turn > 0:  # the first turn compiles
                            times.setdefault((lead, stage), []).append(1e3 * seconds)
        for lead in LEADS:
            cells = []
            for stage in ("estimate", "predict", "occlusion", "select"):
                median = float(np.median(times[lead, stage]))
                ratio = median / float(np.median(times[LEADS[0], stage]))
                cells.append(f"{stage} {median:.2f} ms ({ratio:.2f})")
            print(f"{cameras} cameras x {people} people, lead {lead}: {', '.join(cells)}")


if __name__ == "__main__":
    main()
