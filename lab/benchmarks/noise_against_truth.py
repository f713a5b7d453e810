"""Compare calibrated noise with the truth: known noise, and simulated scenes with all mistakes.

python lab/benchmarks/noise_against_truth.py [--memory]
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.noise import LEAST_SCORE, ErrorMemory
from e3pose.model.pose import Poses2D
from e3pose.recording import Recording, ViewSeries
from e3pose.simulate import DetectorSettings, SceneSettings, simulate
from e3pose.simulate.noise import GROSS_PX, correlated, normal_cdf
from e3pose_lab.noise.calibrate import Calibrated, calibrate_noise
from e3pose_lab.noise.statistics import EDGES, RAYLEIGH, fit_memory

KNOTS, SIGMA_PX = np.array([0.1, 0.4, 0.7, 1.0]), np.array([14.0, 9.0, 5.0, 2.5])
MEMORIES = ((0.45, 0.45), (0.1, 0.2), (0.8, 0.1), (0.1, 0.8))  # lasting, quick
SCENES = (("ring", 5, 1), ("crossing", 5, 2), ("pillar", 4, 3))


def known_noise(cameras: int, memory: ErrorMemory) -> Recording:
    """Return three people of whom each keypoint has a random score, and the error of that score."""
    detector = DetectorSettings(perfect=True)
    settings = SceneSettings(people=3, seconds=12.0, cameras=cameras, detector=detector)
    recording = simulate(settings, seed=1)
    assert recording.truth is not None
    truth_m, rng = recording.truth.joints_m, np.random.default_rng(1)
    views = []
    for camera in recording.rig.cameras:
        pixels, inside = camera.project(truth_m), camera.sees(truth_m)
        wander = correlated(rng, inside.shape, recording.interval_s, ((0.3, 0.1), (0.7, 1.0)))
        scores = np.where(inside, 0.12 + 0.86 * normal_cdf(wander), 0.0)
        errors = correlated(rng, pixels.shape, recording.interval_s, memory.parts)
        pixels = pixels + errors * np.interp(scores, KNOTS, SIGMA_PX)[..., None]
        pixels = np.where(inside[..., None], pixels, np.nan)
        there = [Poses2D(k[s.any(1)], s[s.any(1)]) for k, s in zip(pixels, scores, strict=True)]
        times_s = (np.arange(len(there)) * recording.interval_s).tolist()
        views.append(ViewSeries.from_views(there, range(len(there)), times_s, 17))
    return replace(recording, views=tuple(views))


def true_errors(recording: Recording) -> tuple[Floats, Floats]:
    """Return lengths in pixels, and scores, of all keypoints of people who are there."""
    assert recording.truth is not None
    lengths, scores = [np.zeros(0)], [np.zeros(0)]
    for index, camera in enumerate(recording.rig.cameras):
        expected = camera.project(recording.truth.joints_m)
        for slot in range(recording.num_slots):
            view = recording.view(slot, index)
            for pixels, score in zip(view.keypoints_px, view.scores, strict=True) if view else ():
                apart = np.linalg.norm(expected[slot] - pixels, axis=-1)
                known = np.isfinite(apart) & (score > LEAST_SCORE)
                middles = [
                    np.median(a[k]) if k.any() else np.inf
                    for a, k in zip(apart, known, strict=True)
                ]
                nearest = int(np.argmin(middles))
                if middles[nearest] < GROSS_PX:
                    lengths.append(apart[nearest][known[nearest]])
                    scores.append(score[known[nearest]])
    return np.concatenate(lengths), np.concatenate(scores)


def report(title: str, calibrated: Calibrated, true_px: Floats) -> None:
    print(title)
    print("  score    ", *(f"{score:6.2f}" for score in calibrated.noise.scores))
    print("  measured ", *(f"{ratio:6.2f}" for ratio in calibrated.measured.sigma_px / true_px))
    print("  corrected", *(f"{ratio:6.2f}" for ratio in calibrated.noise.sigma_px / true_px))


def compare_memories() -> None:
    """Print how long errors last: made, measured on residuals, and corrected for the reference."""
    print("shares of the variance: new, quick, lasting")
    for lasting, quick in MEMORIES:
        memory = ErrorMemory(lasting_share=lasting, quick_share=quick)
        detector = DetectorSettings(memory=memory)
        scene = SceneSettings(scene="ring", seconds=20, cameras=5, detector=detector)
        for what, recording in (
            ("known noise", known_noise(5, memory)),
            ("ring", simulate(scene, seed=701)),
        ):
            calibrated = calibrate_noise(recording)
            measured = fit_memory(calibrated.measured.autocorrelation)
            shown = [
                " ".join(f"{share:.2f}" for share, _ in each.parts)
                for each in (memory, measured, calibrated.noise.memory)
            ]
            print(
                f"{what:12} made {shown[0]}   measured {shown[1]}   corrected {shown[2]}",
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--memory", action="store_true", help="compare how long errors last")
    if parser.parse_args().memory:
        compare_memories()
        return
    for cameras in (3, 5, 8):
        calibrated = calibrate_noise(known_noise(cameras, ErrorMemory()))
        true_px = np.interp(calibrated.noise.scores, KNOTS, SIGMA_PX)
        report(f"known noise, {cameras} cameras: by the true sigma", calibrated, true_px)
    for scene, cameras, seed in SCENES:
        recording = simulate(SceneSettings(scene=scene, seconds=20, cameras=cameras), seed=seed)
        calibrated = calibrate_noise(recording)
        lengths, scores = true_errors(recording)
        bins, mine = np.digitize(scores, EDGES), np.digitize(calibrated.noise.scores, EDGES)
        true_px = np.array([np.median(lengths[bins == index]) for index in mine]) / RAYLEIGH
        report(f"{scene}, {cameras} cameras, seed {seed}: by the true sigma", calibrated, true_px)
        gross = np.array([np.mean(lengths[bins == index] > GROSS_PX) for index in mine])
        off = np.abs(calibrated.measured.gross_share - gross).max()
        print(f"  shares of gross errors: off by {off:.3f} at most")


if __name__ == "__main__":
    main()
