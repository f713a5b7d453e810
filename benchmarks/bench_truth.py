"""How right the estimator with a memory is, and how honest, on simulated people.

    python benchmarks/bench_truth.py [SEED ...]

Prints for every scene, with all, two and one of the cameras per slot: the mean error of joints, the
error that the estimator expects, recall, false people, changes of identity, and how many of the
joints lie within the 90 % ellipsoids of their covariances.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from e3pose.estimate.filter import Belief, Estimate, Model
from e3pose.estimate.filter.kernels.step import StepKernel
from e3pose.model.noises import load_noise
from e3pose.recording import Recording
from e3pose.simulate import SceneSettings, simulate

SIMULATED = load_noise("simulated")

Floats = NDArray[np.float64]

SEEDS = (201, 202)  # nothing was chosen on them
SCENES = {
    "ring": SceneSettings("ring", seconds=20),
    "crossing, 5 people": SceneSettings("crossing", people=5, seconds=20),
    "pillar": SceneSettings("pillar", seconds=20),
    "ring, 8 cameras": SceneSettings("ring", seconds=20, cameras=8),
    "crossing, 10 a second": SceneSettings("crossing", seconds=20, fps=10),
    "ring, 60 a second": SceneSettings("ring", seconds=10, fps=60),
}
WARMUP_SLOTS = 10
FOUND_M = 0.5
VISIBLE_JOINTS, VISIBLE_CAMERAS = 6, 2
NINETY = 6.251  # 90 % of chi-squared with three degrees of freedom
MEAN_OF_NORMAL = 0.92  # mean length over root of the summed variances, in three dimensions


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

    def add(self, recording: Recording, slot: int, people: Estimate) -> None:
        """Compare the people of a slot with the truth."""
        assert recording.truth is not None
        truth = recording.truth.joints_m[slot]
        present = np.flatnonzero(np.isfinite(truth).all(axis=(1, 2)))
        sights = [camera.sees(truth[present]).sum(axis=-1) for camera in recording.rig.cameras]
        visible = (np.array(sights) >= VISIBLE_JOINTS).sum(axis=0) >= VISIBLE_CAMERAS
        self.wanted += int(visible.sum())
        self.shown += len(people)
        offset = people.joints_m[:, None] - truth[present][None]
        away = np.linalg.norm(offset, axis=-1)
        apart = np.nanmean(away, axis=-1) if away.size else away[..., 0]
        rows, columns = linear_sum_assignment(np.minimum(apart, 2.0))
        near = apart[rows, columns] < FOUND_M
        self.false += len(people) - int(near.sum())
        for row, column in zip(rows[near], columns[near], strict=True):
            who, track = int(present[column]), int(people.track_ids[row])
            self.changes += self.last.get(who, track) != track
            self.last[who] = track
            if visible[column]:
                self.found += 1
                self._measure(offset[row, column], people.covariance_m2[row])

    def _measure(self, offset_m: Floats, covariance_m2: Floats) -> None:
        known = np.isfinite(offset_m).all(axis=-1)
        off, covariance = offset_m[known], covariance_m2[known]
        squared = np.einsum("ja,jab,jb->j", off, np.linalg.inv(covariance), off)
        self.error_m.append(float(np.linalg.norm(off, axis=-1).mean()))
        spread = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
        self.expected_m.append(float(MEAN_OF_NORMAL * spread.mean()))
        self.inside.append(float((squared < NINETY).mean()))

    def line(self) -> str:
        """Return the figures."""
        return (
            f"{1000 * np.mean(self.error_m):5.1f} {1000 * np.mean(self.expected_m):5.1f} "
            f"{100 * self.found / self.wanted:6.1f} {100 * self.false / max(self.shown, 1):5.2f} "
            f"{self.changes:3d} {100 * np.mean(self.inside):5.1f}"
        )


def spread_order(number: int) -> list[int]:
    """Return cameras of a ring so that neighbours in time are not neighbours in space."""
    stride = 1 if number <= 3 else 2 if number < 8 else 3
    return [camera for first in range(stride) for camera in range(first, number, stride)]


def run(recording: Recording, cameras: int) -> Score:
    """Run the estimator over a recording, so many cameras per slot, taking turns."""
    model = Model(recording.rig, recording.skeleton, SIMULATED)
    step, belief, score = StepKernel(), Belief.empty(model), Score()
    order = spread_order(len(recording.rig))
    for slot in range(recording.num_slots):
        turns = [order[(slot * cameras + turn) % len(order)] for turn in range(cameras)]
        awake = order if slot < WARMUP_SLOTS else turns
        seen = {camera: recording.view(slot, camera) for camera in awake}
        views = {camera: view for camera, view in seen.items() if view is not None}
        belief, people = step(model, belief, views, slot / recording.fps)
        score.add(recording, slot, people)
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
