"""What it is worth to know how long a detector's errors last, on simulated scenes.

    python lab/benchmarks/error_memory.py --scenes ring,pillar --seeds 701,702
    python lab/benchmarks/error_memory.py --made default --measured shelf.toml

The detector's errors last as `made` says; the filter and the policy believe the default memory, the
true one, or that of a noise file. Figures are differences to the default on the same recordings.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from e3pose.evaluate.expected_figures import expected_figures
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import accuracy
from e3pose.model.noise import ErrorMemory
from e3pose.model.noises import encode_noise, load_noise_file
from e3pose.recording import Recording
from e3pose.simulate import SCENES, DetectorSettings, SceneSettings, simulate

FPS, SECONDS = 12.5, 16.0
LEAD_SLOTS = 4
MADE = {
    "default": ErrorMemory(),
    "new": ErrorMemory(lasting_share=0.1, quick_share=0.2),
    "lasting": ErrorMemory(lasting_share=0.8, quick_share=0.1),
    "quick": ErrorMemory(lasting_share=0.1, quick_share=0.8),
}


def figures(recording: Recording, cameras: int, seed: int, noise: Path) -> list[float]:
    """Return MPJPE and the expected error in mm, and 90 % coverage in percent."""
    everyone = cameras >= len(recording.rig)
    settings = ReplaySettings(
        policy="all" if everyone else "information",
        num_selected=min(cameras, len(recording.rig)),
        lead_slots=LEAD_SLOTS,
        seed=seed,
        phase=seed,
        noise=str(noise),
    )
    records = list(replay(recording, settings))
    found, stated = accuracy(recording, records), expected_figures(recording, records)
    values = found.mpjpe_mm, stated.error_mm, stated.coverage_90
    error_mm, expected_mm, coverage = (np.nan if value is None else value for value in values)
    return [error_mm, expected_mm, coverage]


def compare(scenes: Sequence[str], seeds: Sequence[int], made: str, files: dict[str, Path]) -> None:
    """Print a row per number of cameras and belief."""
    detector = DetectorSettings(memory=MADE[made])
    recordings = [
        (simulate(SceneSettings(scene=s, seconds=SECONDS, fps=FPS, detector=detector), seed), seed)
        for s in scenes
        for seed in seeds
    ]
    for cameras in (1, 2, 99):
        rows = {
            name: np.array([figures(each, cameras, seed % 1000, file) for each, seed in recordings])
            for name, file in files.items()
        }
        usual = next(iter(rows.values()))
        for name, row in rows.items():
            changes = 100 * (row[:, 0] / usual[:, 0] - 1)
            error = changes.std(ddof=1) / np.sqrt(len(changes)) if len(changes) > 1 else np.nan
            mpjpe, expected, coverage = row.mean(axis=0)
            print(
                f"made {made:8} cameras {cameras:2} believed {name:8} MPJPE {mpjpe:6.2f} mm "
                f"{changes.mean():+6.2f} +- {error:.2f} %, expected {expected:6.2f} mm, "
                f"90 % band {coverage:.1f} %",
                flush=True,
            )


def main() -> None:
    """Print tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--seeds", default="701")
    parser.add_argument("--made", default=",".join(MADE))
    parser.add_argument("--measured", type=Path, help="a noise file whose memory is believed, too")
    options = parser.parse_args()
    right = load_noise_file("simulated")
    with tempfile.TemporaryDirectory() as folder:
        for made in options.made.split(","):
            believed = {"default": ErrorMemory(), "true": MADE[made]}
            if options.measured is not None:
                believed["measured"] = load_noise_file(options.measured).memory
            if made == "default":
                del believed["true"]
            files = {}
            for name, memory in believed.items():
                files[name] = Path(folder) / f"{name}.toml"
                file = msgspec.structs.replace(right, memory=memory)
                files[name].write_text(encode_noise(file), encoding="utf-8")
            seeds = [int(seed) for seed in options.seeds.split(",")]
            compare(options.scenes.split(","), seeds, made, files)


if __name__ == "__main__":
    main()
