"""Check that views agree with the rig and the truth, in pixels."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.known import mean_of_known
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.recording.record import Recording

SAMPLED_SLOTS = 60
MAX_SAMPLED_PEOPLE = 12  # of one view
MIN_SAMPLES = 10
MIN_JOINTS = 5


def epipolar_distances_px(recording: Recording) -> Floats:
    """Measure how far people lie from the epipolar lines of their likeliest candidates.

    Returns:
        `(num_cameras, num_cameras)` pixels in the image of the row's camera: the median, over
        people of sampled slots, of the distance to the best partner in the column's camera. NaN
        where fewer than ten people could be compared.
    """
    rig = recording.rig
    num_cameras = len(rig)
    samples: list[list[list[float]]] = [[[] for _ in rig.cameras] for _ in rig.cameras]
    lines = _fundamentals(rig)
    for slot in _sampled_slots(recording):
        views = [_sample(recording.view(slot, camera)) for camera in range(num_cameras)]
        pixels = [
            rig.cameras[camera].undistort(view.keypoints_px) for camera, view in enumerate(views)
        ]
        for row in range(num_cameras):
            for column in range(num_cameras):
                if row == column or not len(views[row]) or not len(views[column]):
                    continue
                distances = _line_distances(pixels[row], pixels[column], lines[column, row])
                best = np.nanmin(np.where(np.isnan(distances), np.inf, distances), axis=1)
                samples[row][column] += best[np.isfinite(best)].tolist()
    return np.array(
        [[np.median(c) if len(c) >= MIN_SAMPLES else np.nan for c in row] for row in samples]
    )


def truth_distances_px(recording: Recording) -> Floats:
    """Measure how far the truth projects from the nearest person that a camera saw.

    Returns:
        `(num_cameras,)` pixels, median over sampled slots and annotated people; NaN where fewer
        than ten could be compared.
    """
    truth = recording.truth
    rig = recording.rig
    samples: list[list[float]] = [[] for _ in rig.cameras]
    if truth is None:
        return np.full(len(rig), np.nan)
    shared = [name for name in truth.skeleton.joints if name in recording.skeleton.joints]
    truth_columns = [truth.skeleton.joints.index(name) for name in shared]
    view_columns = [recording.skeleton.joints.index(name) for name in shared]
    annotated = np.flatnonzero(np.any(np.any(truth.annotated, axis=2), axis=1))
    step = max(1, len(annotated) // SAMPLED_SLOTS)
    for slot in annotated[::step].tolist():
        joints_m = truth.joints_m[slot][:, truth_columns]
        for camera in range(len(rig)):
            view = _sample(recording.view(slot, camera))
            if not len(view):
                continue
            expected = rig.cameras[camera].project(joints_m)
            expected[~rig.cameras[camera].sees(joints_m)] = np.nan
            offsets = expected[:, None] - view.keypoints_px[None][:, :, view_columns]
            distances = mean_of_known(np.linalg.norm(offsets, axis=-1), MIN_JOINTS)
            best = np.min(np.where(np.isnan(distances), np.inf, distances), axis=1)
            samples[camera] += best[np.isfinite(best)].tolist()
    return np.array([np.median(s) if len(s) >= MIN_SAMPLES else np.nan for s in samples])


def _sampled_slots(recording: Recording) -> list[int]:
    peopled = [series.slots[np.diff(series.starts) > 0] for series in recording.views]
    slots, counts = np.unique(np.concatenate(peopled), return_counts=True)
    useful = slots[counts >= 2]
    return [int(slot) for slot in useful[:: max(1, len(useful) // SAMPLED_SLOTS)]]


def _sample(view: Poses2D | None) -> Poses2D:
    if view is None:
        return Poses2D.empty(0)
    rows = slice(0, MAX_SAMPLED_PEOPLE)
    return Poses2D(view.keypoints_px[rows], view.scores[rows])


def _fundamentals(rig: Rig) -> Floats:
    """Return `(num_cameras, num_cameras, 3, 3)`: [a, b] maps pixels of a to lines in b."""
    F = np.zeros((len(rig), len(rig), 3, 3))
    for a in range(len(rig)):
        for b in range(len(rig)):
            if a != b:
                F[a, b] = rig.fundamental(a, b)
    return F


def _line_distances(pixels: Floats, candidates: Floats, F: Floats) -> Floats:
    """Return `(num_persons, num_candidates)` mean pixels from joints to candidates' lines."""
    homogeneous = np.concatenate([candidates, np.ones_like(candidates[..., :1])], axis=-1)
    lines = homogeneous @ F.T
    length = np.hypot(lines[..., 0], lines[..., 1])
    lines = lines / np.where(length > 0, length, np.nan)[..., None]
    own = np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)
    return mean_of_known(np.abs((own[:, None] * lines[None]).sum(axis=-1)), MIN_JOINTS)
