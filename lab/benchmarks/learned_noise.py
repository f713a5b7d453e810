"""What wrong noise costs: replays with noise files that are mis-stated, missing, or another's."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from e3pose.evaluate.expected_figures import expected_figures
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import accuracy
from e3pose.model.noises import encode_noise, load_noise_file
from e3pose.recording import Recording
from e3pose.simulate import SceneSettings, simulate

SCENES = ("ring", "two-rooms", "one-sided", "pillar", "l-hall")
SEEDS = (701, 702, 703, 704)
FPS, SECONDS = 12.5, 16.0
TIMES = (0.5, 1.0, 2.0, 4.0)
OTHERS = ("openpose", "openpose-thin", "movenet-multipose", "rtmlib")


def noises(folder: Path) -> Iterator[tuple[str, str | None]]:
    """Yield what each noise is called, and its file; None where the detector is not known."""
    right = load_noise_file("simulated")
    for times in TIMES:
        file = folder / f"{times:g}.toml"
        wrong = msgspec.structs.replace(right, sigma_px=[times * s for s in right.sigma_px])
        file.write_text(encode_noise(wrong))
        yield f"simulated x {times:g}", str(file)
    yield "none known", None
    for name in OTHERS:
        yield name, name


def figures(recording: Recording, cameras: int, seed: int, noise: str | None) -> list[float]:
    """Return MPJPE in mm, recall, false people and 90 % coverage in percent."""
    everyone = cameras >= len(recording.rig)
    settings = ReplaySettings(
        policy="all" if everyone else "round-robin",
        num_selected=min(cameras, len(recording.rig)),
        seed=seed,
        phase=seed,
        noise=noise,
    )
    unnamed = recording if noise else replace(recording, detector="one that nobody knows")
    records = list(replay(unnamed, settings))
    found, stated = accuracy(recording, records), expected_figures(recording, records)
    precision = 1.0 if found.precision_500mm is None else found.precision_500mm
    figures = found.mpjpe_mm, found.recall_500mm, precision, stated.coverage_90
    error_mm, recall, right, coverage = (np.nan if f is None else f for f in figures)
    return [error_mm, 100 * recall, 100 * (1 - right), coverage]


def main() -> None:
    """Print a row per noise and number of cameras."""
    settings = [SceneSettings(scene=scene, seconds=SECONDS, fps=FPS) for scene in SCENES]
    recordings = [(simulate(each, seed), seed) for each in settings for seed in SEEDS]
    with tempfile.TemporaryDirectory() as folder:
        files = list(noises(Path(folder)))
        for cameras in (1, 2, 99):
            for name, file in files:
                rows = [figures(each, cameras, seed % 1000, file) for each, seed in recordings]
                mpjpe, recall, false, coverage = np.mean(rows, axis=0)
                print(f"{cameras} {name}: {mpjpe:.2f} {recall:.2f} {false:.2f} {coverage:.1f}")


if __name__ == "__main__":
    main()
