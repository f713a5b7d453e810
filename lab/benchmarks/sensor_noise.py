"""How noisy is a detector of which its COCO AP alone is known, such as that of an AI Camera?

    python lab/benchmarks/sensor_noise.py     # two minutes

Errors of simulated detections, which are those of OpenPose, are made larger until COCO's average
precision of simulated people is that of the detector. That takes all that it lacks for noise: what
it misses beyond OpenPose would make it less noisy. Then rooms are replayed with such detections, as
`e3pose power plan` asks by how much the error of poses is larger.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from adaptive_choice import ADAPTIVE, FPS, figures
from e3pose.base.arrays import Floats
from e3pose.model.pose import Poses2D
from e3pose.recording import Recording, ViewSeries
from e3pose.simulate import SceneSettings, simulate
from e3pose.simulate.noise import GROSS_PX

DETECTOR, AP = "imx500", 0.19  # of HigherHRNet on the AI Camera, as Raspberry Pi states
FACTORS = np.arange(1.0, 3.6, 0.25)
SCENES = (("ring", 5, 1), ("crossing", 5, 2), ("pillar", 4, 3))
ROOMS = ((1, 4, 1.0), (3, 4, 2.0), (3, 6, 1.5), (3, 6, 3.0))  # people, cameras, active ones
SEEDS = (1400, 1401)
# Of COCO: how far labels of its keypoints are off, a person's area by the box of the keypoints, and
# the similarities that count.
SIGMAS = np.array([26, 25, 25, 35, 35, 79, 79, 72, 72, 62, 62, 107, 107, 87, 87, 89, 89]) / 1000
AREA_OF_BOX, SIMILARITIES = 0.53, np.arange(0.5, 0.96, 0.05)


def seen(recording: Recording, camera: int) -> Floats:
    """Return `(num_slots, num_persons, num_joints, 2)` true pixels, NaN outside of the image."""
    assert recording.truth is not None
    truth_m, lens = recording.truth.joints_m, recording.rig.cameras[camera]
    return np.where(lens.sees(truth_m)[..., None], lens.project(truth_m), np.nan)


def noisier(recording: Recording, factor: float) -> Recording:
    """Make the errors of all detections, but of false ones, so many times as large."""
    views = []
    for camera in range(len(recording.rig)):
        true_px, made = seen(recording, camera), []
        for slot in range(recording.num_slots):
            view = recording.view(slot, camera) or Poses2D.empty(len(SIGMAS))
            off_px = view.keypoints_px[:, None] - true_px[slot]
            apart_px, both = np.linalg.norm(off_px, axis=-1), np.isfinite(off_px).all(axis=-1)
            mean_px = np.nansum(apart_px, axis=-1) / np.maximum(both.sum(axis=-1), 1)
            moved = view.keypoints_px.copy()
            for row, each in enumerate(np.where(both.any(axis=-1), mean_px, np.inf)):
                if each.min(initial=np.inf) < GROSS_PX:
                    moved[row] += (factor - 1) * np.nan_to_num(off_px[row, each.argmin()])
            made.append(Poses2D(moved, view.scores))
        times_s = (np.arange(len(made)) * recording.interval_s).tolist()
        views.append(ViewSeries.from_views(made, range(len(made)), times_s, len(SIGMAS)))
    return replace(recording, views=tuple(views), detector=DETECTOR)


def average_precision(recordings: Sequence[Recording]) -> float:
    """Return COCO's average precision of the detections."""
    found: list[tuple[float, float]] = []  # score and similarity
    people = 0
    for recording, camera in ((r, c) for r in recordings for c in range(len(r.rig))):
        for slot, pixels in enumerate(seen(recording, camera)):
            there = pixels[np.isfinite(pixels).any(axis=(1, 2))]
            people += len(there)
            view = recording.view(slot, camera)
            if view is None or not len(view):
                continue
            boxes = np.nanmax(there, axis=1) - np.nanmin(there, axis=1)
            area = AREA_OF_BOX * np.maximum(boxes.prod(axis=-1), 1.0)
            errors = ((view.keypoints_px[:, None] - there) ** 2).sum(axis=-1)
            errors /= 2 * area[:, None] * (2 * SIGMAS) ** 2
            labelled = np.isfinite(there).all(axis=-1)
            alike = np.nan_to_num(np.exp(-errors)).sum(axis=-1) / labelled.sum(axis=-1)
            for row in np.argsort(-view.scores.mean(axis=-1)):
                best = alike[row].max(initial=0.0)
                found.append((view.scores[row].mean(), best))
                if best >= SIMILARITIES[0]:
                    alike[:, alike[row].argmax()] = 0.0  # nobody is found twice
    similarities = np.array(sorted(found, reverse=True))[:, 1]
    hits = np.cumsum(similarities >= SIMILARITIES[:, None], axis=1)  # by similarity that counts
    precision = np.maximum.accumulate((hits / np.arange(1, len(found) + 1))[:, ::-1], axis=1)
    padded = np.pad(precision[:, ::-1], ((0, 0), (0, 1)))
    places = [np.searchsorted(each, np.linspace(0, 1, 101)) for each in hits / people]
    return float(np.mean([each[at] for each, at in zip(padded, places, strict=True)]))


def main() -> None:
    scenes = [
        simulate(SceneSettings(scene=scene, seconds=20, fps=5, cameras=cameras), seed=seed)
        for scene, cameras, seed in SCENES
    ]
    found = [average_precision([noisier(each, factor) for each in scenes]) for factor in FACTORS]
    for factor, each in zip(FACTORS, found, strict=True):
        print(f"noise of OpenPose times {factor:.2f}: AP {each:.3f}", flush=True)
    factor = float(np.interp(-AP, -np.array(found), FACTORS))
    print(f"AP {AP}: times {factor:.2f}", flush=True)
    ratios = []
    for people, cameras, active in ROOMS:
        for seed in SEEDS:
            settings = SceneSettings(people=people, cameras=cameras, seconds=20, fps=FPS)
            room = simulate(settings, seed)
            both = [figures(r, ADAPTIVE, active, seed, 4) for r in (room, noisier(room, factor))]
            before, after = (each["mpjpe_mm"] for each in both)
            ratios.append(after / before)
            print(f"{people} people, {active:g} of {cameras}: {before:.1f} to {after:.1f} mm")
    print(f"error times {np.mean(ratios):.2f}, {min(ratios):.2f} to {max(ratios):.2f}")


if __name__ == "__main__":
    main()
