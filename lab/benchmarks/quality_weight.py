"""What the paper's policy finds by its V, in camera slots, on simulated people and motion capture.

    python lab/benchmarks/quality_weight.py --mocap cmu_mocap_train_30fps.npz

Rings of five cameras, three awake, pipeline `paper`, motion vectors as predictor. Per scene: mean
error in mm, with everybody who is not found counted as 500 mm off; then the largest share of slots
of a camera, with a budget of 0.8, and the longest queue in slots.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

WEIGHTS = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
SCENES = ("ring", "crossing", "meeting")
CROWDS = (
    ("01_01", "01_02", "01_03", "01_04"),
    ("01_05", "01_09", "01_10", "01_11"),
    ("01_08", "01_12", "02_10", "01_02"),
    ("02_05", "02_06", "01_03", "01_11"),
)  # of motion capture: four clips at a time
SEEDS = (701, 702, 703, 704)
SECONDS, FPS = 12.0, 12.5
STRIDE = 2  # of motion capture at 30 slots per second
MISSED_M = 0.5


def crowd(mocap: Path, number: int) -> Any:
    """Return four people of motion capture, each somewhere and turned somehow, five cameras."""
    from e3pose.model.rigs import ring_rig
    from e3pose.model.skeleton import COCO17
    from e3pose.recording import Truth
    from e3pose.recording.datasets.motion import import_cmu
    from e3pose_lab.train.watched import as_coco17, watched

    rng = np.random.default_rng(720 + number)
    slots = round(SECONDS * 30)
    people = []
    for index, clip in enumerate(CROWDS[number]):
        recording = import_cmu(mocap, clip)
        joints = as_coco17(recording.truth.joints_m[:, 0])  # type: ignore[union-attr]
        while len(joints) < slots:
            joints = np.concatenate([joints, joints[::-1]])
        joints = joints[:slots:STRIDE].copy()
        angle, turn = np.pi / 2 * index + rng.uniform(0, 1), rng.uniform(0, 2 * np.pi)
        spot = rng.uniform(0.6, 1.1) * np.array([np.cos(angle), np.sin(angle)])
        turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        middle = joints[:, 11:13, :2].mean(axis=(0, 1))
        joints[..., :2] = (joints[..., :2] - middle) @ turned.T + spot
        people.append(joints)
    rig = ring_rig(5, 4.2, 2.0, (1032, 776), rng)
    names = tuple(f"person{index + 1}" for index in range(len(people)))
    truth = Truth(COCO17, names, np.stack(people, axis=1))
    there = replace(
        recording, name=f"CMU crowd {number}", rig=rig, fps=30.0 / STRIDE,
        num_slots=len(truth.joints_m), truth=truth,
    )  # fmt: skip
    return watched(there, 720 + number, 4.2)


def figures(recording: Any, weight: float) -> list[float]:
    """Return the error in mm with misses, the largest duty and the longest queue."""
    from e3pose.evaluate.metrics import candidates, first_matches, mpjpe_mm
    from e3pose.evaluate.replay import ReplaySettings, replay

    settings = ReplaySettings(
        pipeline="paper", fill=False, policy="e3pose-mv", num_selected=3, quality_weight=weight
    )
    records = list(replay(recording, settings))
    found = candidates(
        [record.poses.joints_m for record in records],
        [record.poses.scores.mean(axis=-1) for record in records],
        recording.truth.joints_m,
    )
    recall = float(first_matches(found, MISSED_M).sum()) / found.num_truths
    error_mm = recall * (mpjpe_mm(found) or 0.0) + (1 - recall) * 1000 * MISSED_M
    duty = np.mean([record.selected for record in records[12:]], axis=0)
    return [error_mm, float(duty.max()), float(max(r.deficit.max() for r in records))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--mocap", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    options = parser.parse_args()
    table = measure(options.mocap, options.seeds)
    print(f"| | {' | '.join(f'{weight:g}' for weight in WEIGHTS)} |")
    print("|---" * (len(WEIGHTS) + 1) + "|")
    for scene, values in table.items():
        print(f"| {scene}, mm | {' | '.join(f'{e:.1f}' for e in values.mean(axis=0)[:, 0])} |")
    each = np.stack([values.mean(axis=0) for values in table.values()])
    ratio = np.exp(np.log(each[:, :, 0] / each[:, :1, 0]).mean(axis=0))
    print(f"| error against V = 0, all | {' | '.join(f'{r:.3f}' for r in ratio)} |")
    for title, column in (("largest duty", 1), ("longest queue", 2)):
        cells = [f"{value:.2f}" for value in each[:, :, column].mean(axis=0)]
        print(f"| {title} | {' | '.join(cells)} |")


def measure(mocap: Path, seeds: Sequence[int]) -> dict[str, Floats]:
    """Return `(num_recordings, num_weights, 3)` figures by scene."""
    from e3pose.simulate import SceneSettings, simulate

    table = {}
    for scene in SCENES:
        settings = SceneSettings(scene=scene, seconds=SECONDS, fps=FPS)
        table[scene] = [simulate(settings, seed) for seed in seeds]
    table["motion capture"] = [crowd(mocap, number) for number in range(len(CROWDS))]
    return {
        scene: np.array([[figures(recording, v) for v in WEIGHTS] for recording in recordings])
        for scene, recordings in table.items()
    }


if __name__ == "__main__":
    main()
