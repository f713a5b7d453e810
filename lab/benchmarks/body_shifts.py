"""How far whole bodies are off in a view: how much evidence one body is of a camera's shift.

    python lab/benchmarks/body_shifts.py RECORDING

Without labels: residuals to the offline smoother over every view of every camera, in pixels of an
image of 1032. Each row is of means over one body in one view, and in windows of 2.5 s: how far they
scatter about the mean of their view, and about how many independent keypoints would scatter so.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.evaluate.noise.calibrate import all_camera_tracks
from e3pose.evaluate.noise.residuals import assign_detections
from e3pose.evaluate.smoother import smooth
from e3pose.model.noise import IMAGE_PX, LEAST_SCORE
from e3pose.model.noises import detector_of, load_noise
from e3pose.recording import load_recording

GROSS_PX = 40.0  # left out
WINDOW_S = 2.5  # how long errors of a keypoint last
LEAST_KEYPOINTS = 100  # of a mean
ONE_KEYPOINT_PX = 16.0  # so far is the mean of n independent ones off, times the root of n


def means(residuals: Floats, length: int) -> Floats:
    """Return `(num_means, 4)`: view, number of keypoints and mean residual, of parts of a body.

    Args:
        residuals: `(num_slots, num_views, num_joints, 2)` pixels of one body, NaN where unknown.
        length: slots of a part.
    """
    rows = []
    for start in range(0, len(residuals), length):
        for view in range(residuals.shape[1]):
            part = residuals[start : start + length, view]
            known = part[np.isfinite(part).all(axis=-1)]
            if len(known) >= LEAST_KEYPOINTS:
                rows.append([view, len(known), *known.mean(axis=0)])
    return np.array(rows).reshape(-1, 4)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("recording", type=Path)
    recording = load_recording(parser.parse_args().recording)
    noise = load_noise(detector_of(recording))
    sizes = np.array([max(camera.image_size) for camera in recording.rig.cameras])
    tracks, _, _ = all_camera_tracks(recording, recording.num_slots)
    lengths = {
        "a body": recording.num_slots,
        "2.5 s": max(1, round(WINDOW_S / recording.interval_s)),
    }
    found: dict[str, list[Floats]] = {name: [] for name in lengths}
    for body in assign_detections(recording, tracks, recording.num_slots):
        scale = (sizes / noise.image_px)[:, None]
        sigma = np.where(body.scores > LEAST_SCORE, noise.of(body.scores, scale), np.inf)
        rig = recording.rig.projections
        path = smooth(body.keypoints_px, sigma, rig, body.joints_m, recording.interval_s)
        at = np.einsum("vab,tjb->tvja", rig[..., :3], path) + rig[:, None, :, 3]
        off = (body.keypoints_px - at[..., :2] / at[..., 2:]) * (IMAGE_PX / sizes)[:, None, None]
        right = (body.scores > LEAST_SCORE) & (np.linalg.norm(off, axis=-1) < GROSS_PX)
        for name, length in lengths.items():
            found[name].append(means(np.where(right[..., None], off, np.nan), length))
    print("means of   number  keypoints  scatter px  as of independent")
    for name, parts in found.items():
        rows = np.concatenate(parts)
        views = [rows[rows[:, 0] == view] for view in np.unique(rows[:, 0])]
        spread = [view[:, 2:].var(axis=0, ddof=1) for view in views if len(view) > 1]
        variance = float(np.mean(spread)) if spread else np.nan
        independent = ONE_KEYPOINT_PX**2 / variance
        keypoints = rows[:, 1].mean()
        print(f"{name:9}{len(rows):8}{keypoints:11.0f}{np.sqrt(variance):12.2f}{independent:19.0f}")


if __name__ == "__main__":
    main()
