"""What a constant shift of one camera costs, and what of it is learned and taken off."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import accuracy
from e3pose.recording import Recording
from e3pose.simulate import SceneSettings, simulate

SCENES = ("ring", "two-rooms", "one-sided", "pillar", "l-hall")
FPS = 12.5
DIRECTION = 0.6  # of the shift, radians from right to down
SHIFTS_PX = (0.0, 3.0, 6.0, 12.0)  # of an image of 1032


def shifted(recording: Recording, shift_px: float) -> Recording:
    """Return the recording with all keypoints of its first camera moved."""
    scale = max(recording.rig.cameras[0].image_size) / 1032
    moved = shift_px * scale * np.array([np.cos(DIRECTION), np.sin(DIRECTION)])
    first, *others = recording.views
    return replace(
        recording, views=(replace(first, keypoints_px=first.keypoints_px + moved), *others)
    )


def figures(recording: Recording, cameras: int, seed: int) -> list[float]:
    """Return MPJPE and the 95th percentile in mm, and what was found of the shift in pixels."""
    everyone = cameras >= len(recording.rig)
    settings = ReplaySettings(
        policy="all" if everyone else "round-robin",
        num_selected=min(cameras, len(recording.rig)),
        seed=seed,
        phase=seed,
    )
    records = list(replay(recording, settings))
    found = accuracy(recording, records)
    shifts_px = records[-1].shifts_px
    first_px = np.nan if shifts_px is None else float(np.hypot(*shifts_px[0]))
    return [found.mpjpe_mm or np.nan, found.p95_mm or np.nan, first_px]


def main() -> None:
    """Print a row per shift and number of cameras."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seeds", default="711")
    options = parser.parse_args()
    seeds = [int(seed) for seed in options.seeds.split(",")]
    recordings = [
        (simulate(SceneSettings(scene=scene, seconds=options.seconds, fps=FPS), seed), seed)
        for scene in SCENES
        for seed in seeds
    ]
    print("shift cameras  MPJPE mm   95 % mm  found px, median")
    for shift_px in SHIFTS_PX:
        for cameras in (1, 2, 99):
            rows = np.array(
                [figures(shifted(each, shift_px), cameras, seed) for each, seed in recordings]
            )
            mpjpe, p95 = np.exp(np.log(rows[:, :2]).mean(axis=0))
            found_px = np.nanmedian(rows[:, 2])
            print(
                f"{shift_px:5g} {cameras:7d} {mpjpe:9.1f} {p95:9.1f} {found_px:10.1f}", flush=True
            )


if __name__ == "__main__":
    main()
