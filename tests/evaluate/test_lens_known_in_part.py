"""What lies beyond the angle to which a lens was measured counts for nothing, wherever it is used.

A live edge runs the estimators of a replay. Within an image people may still be followed there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.calibrate.people_scenes import distances, walk

from e3pose.calibrate.from_people import solve_people
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.camera import Camera, Rig
from e3pose.model.noises import load_noise
from e3pose.recording.record import Recording, ViewSeries

KNOWN_TO = np.radians(20.0)
NOISE = load_noise("simulated")

pytestmark = pytest.mark.slow


def off_axis(camera: Camera, keypoints_px: np.ndarray) -> np.ndarray:
    """Return which pixels a lens without distortion sees farther off its axis than it is known."""
    points = (keypoints_px - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]]
    return np.asarray(np.hypot(points[..., 0], points[..., 1]) > np.tan(KNOWN_TO))


def beyond(recording: Recording, index: int) -> np.ndarray:
    """Return which keypoints of a camera are farther off its axis than its lens is known."""
    return off_axis(recording.rig.cameras[index], recording.views[index].keypoints_px)


def changed(recording: Recording, how: str) -> Recording:
    """Return it with lenses known in part, and keypoints beyond that part "wild" or "missing"."""
    cameras, views = [], []
    for index, (camera, series) in enumerate(
        zip(recording.rig.cameras, recording.views, strict=True)
    ):
        cameras.append(replace(camera, distortion=np.zeros(4), known_to=KNOWN_TO))
        views.append(_spoilt(series, beyond(recording, index), camera.K[:2, 2], how))
    return replace(recording, rig=Rig(tuple(cameras)), views=tuple(views), truth=None)


def _spoilt(series: ViewSeries, rows: np.ndarray, middle: np.ndarray, how: str) -> ViewSeries:
    away = series.keypoints_px - middle
    wild = np.where(rows[..., None], middle + 1.4 * away, series.keypoints_px)
    if how == "wild":
        return replace(series, keypoints_px=wild)
    missing = np.where(rows[..., None], np.nan, series.keypoints_px)
    return replace(series, keypoints_px=missing, scores=np.where(rows, 0.0, series.scores))


@pytest.fixture(scope="module")
def both() -> tuple[Recording, Recording]:
    recording = walk(733, people=2, seconds=12.0, fps=5.0)
    share = np.mean(np.concatenate([beyond(recording, i).ravel() for i in range(4)]))
    assert 0.1 < share < 0.7
    return changed(recording, "wild"), changed(recording, "missing")


@pytest.mark.parametrize("pipeline", ["memory", "paper"])
def test_people_are_placed_without_it(both: tuple[Recording, Recording], pipeline: str) -> None:
    settings = ReplaySettings(pipeline=pipeline, num_selected=3)
    poses = [[record.people for record in replay(each, settings)] for each in both]
    assert sum(len(each) for each in poses[0]) > 50
    for wild, missing in zip(*poses, strict=True):
        np.testing.assert_array_equal(wild.joints_m, missing.joints_m)


def test_cameras_are_placed_without_it(both: tuple[Recording, Recording]) -> None:
    wild = both[0]
    found = solve_people(wild, NOISE, wild.rig)
    pixels = found.joints.keypoints_px[:, found.solved.used]
    far = np.stack([off_axis(c, p) for c, p in zip(wild.rig.cameras, pixels, strict=True)])
    far &= np.isfinite(pixels[..., 0])
    assert far.sum() > 100
    assert not np.isfinite(found.solved.adjusted.residuals[:, :, 0, 0][far]).any()
    degrees, millimetres, _ = distances(found.solved.adjusted.rig, wild.rig)
    assert degrees < 0.5 and millimetres < 50
