"""How right the estimator with a memory is, and how honest, on simulated people.

    python lab/benchmarks/bench_truth.py [SEED ...]

Prints for every scene, with all, two and one of the cameras per slot: the mean error of joints, the
error that is reported, recall, false people, changes of identity, and how many of the joints are
within the reported 90 % radius.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from e3pose.base.arrays import Floats
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.uncertainty import distance_within_m, expected_distance_m
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording
from e3pose.simulate import SceneSettings, simulate

SEEDS = (201, 202)  # nothing was chosen on them
SCENES = {
    "ring": SceneSettings("ring", seconds=20),
    "crossing, 5 people": SceneSettings("crossing", people=5, seconds=20),
    "pillar": SceneSettings("pillar", seconds=20),
    "ring, 8 cameras": SceneSettings("ring", seconds=20, cameras=8),
    "crossing, 10 a second": SceneSettings("crossing", seconds=20, fps=10),
    "ring, 60 a second": SceneSettings("ring", seconds=10, fps=60),
}
FOUND_M = 0.5
VISIBLE_JOINTS, VISIBLE_CAMERAS = 6, 2


@dataclass(slots=True)
class Score:
    """Sums over slots."""

    wanted: int = 0
    found: int = 0
    shown: int = 0
    false: int = 0
    changes: int = 0
    error_m: list[float] = field(default_factory=list)
    expected_m: list[float] = field(default_factory=list)
    inside: list[float] = field(default_factory=list)
    last: dict[int, int] = field(default_factory=dict)

    def add(self, recording: Recording, record: SlotRecord) -> None:
        """Compare the people of a slot with the truth."""
        assert recording.truth is not None
        truth = recording.truth.joints_m[record.slot]
        present = np.flatnonzero(np.isfinite(truth).all(axis=(1, 2)))
        sights = [camera.sees(truth[present]).sum(axis=-1) for camera in recording.rig.cameras]
        visible = (np.array(sights) >= VISIBLE_JOINTS).sum(axis=0) >= VISIBLE_CAMERAS
        self.wanted += int(visible.sum())
        self.shown += len(record.people.track_ids)
        offset = record.people.joints_m[:, None] - truth[present][None]
        away = np.linalg.norm(offset, axis=-1)
        apart = np.nanmean(away, axis=-1) if away.size else away[..., 0]
        rows, columns = linear_sum_assignment(np.minimum(apart, 2.0))
        near = apart[rows, columns] < FOUND_M
        self.false += len(record.people.track_ids) - int(near.sum())
        for row, column in zip(rows[near], columns[near], strict=True):
            who, track = int(present[column]), int(record.people.track_ids[row])
            self.changes += self.last.get(who, track) != track
            self.last[who] = track
            if visible[column]:
                self.found += 1
                self._measure(offset[row, column], record.people.covariance_m2[row])

    def _measure(self, offset_m: Floats, covariance_m2: Floats) -> None:
        known = np.isfinite(offset_m).all(axis=-1)
        off, covariance = offset_m[known], covariance_m2[known]
        error_m = np.linalg.norm(off, axis=-1)
        self.error_m.append(float(error_m.mean()))
        self.expected_m.append(float(expected_distance_m(covariance).mean()))
        self.inside.append(float((error_m < distance_within_m(covariance, 0.9)).mean()))

    def line(self) -> str:
        """Return the figures."""
        return (
            f"{1000 * np.mean(self.error_m):5.1f} {1000 * np.mean(self.expected_m):5.1f} "
            f"{100 * self.found / self.wanted:6.1f} {100 * self.false / max(self.shown, 1):5.2f} "
            f"{self.changes:3d} {100 * np.mean(self.inside):5.1f}"
        )


def run(recording: Recording, cameras: int) -> Score:
    """Replay a recording with so many cameras per slot, taking turns."""
    policy = "all" if cameras == len(recording.rig) else "round-robin"
    settings = ReplaySettings(policy=policy, num_selected=None if policy == "all" else cameras)
    score = Score()
    for record in replay(recording, settings):
        score.add(recording, record)
    return score


def main(seeds: tuple[int, ...]) -> None:
    """Print the table."""
    print(f"{'':30} mm    said  recall false  id  in 90 %")
    for name, settings in SCENES.items():
        for seed in seeds:
            recording = simulate(settings, seed)
            for cameras in (len(recording.rig), 2, 1):
                label = f"{name}, {seed}: {cameras}"
                print(f"{label:30} {run(recording, cameras).line()}", flush=True)


if __name__ == "__main__":
    main(tuple(int(seed) for seed in sys.argv[1:]) or SEEDS)
