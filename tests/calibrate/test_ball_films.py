"""A ball in films places cameras: films of a simulated rig, drawn and encoded."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from tests.calibrate.people_scenes import distances
from tests.cli.commands import run

from e3pose.camera.video_file import VideoFile
from e3pose.geometry.camera import Rig
from e3pose.geometry.rigs import ring_rig
from e3pose.recording.calibration import load_rig, save_rig

pytestmark = pytest.mark.slow

SIZE, FPS, SECONDS = (640, 480), 10.0, 20.0
RADIUS_M = 0.06
GREEN, GREY = (20, 190, 60), 110
SUBPIXEL = 4  # bits of OpenCV's fixed-point coordinates


@pytest.fixture(scope="module")
def rig() -> Rig:
    return ring_rig(4, 4.0, 2.2, SIZE, np.random.default_rng(751))


@pytest.fixture(scope="module")
def films(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Films of a green ball that is carried through the room, in and out of pictures."""
    folder = tmp_path_factory.mktemp("films")
    times = np.arange(0, SECONDS, 1 / FPS)
    path_m = np.stack([
        1.6 * np.sin(0.9 * times), 1.6 * np.sin(1.3 * times + 1), 1.1 + 0.8 * np.sin(0.7 * times)
    ], axis=-1)  # fmt: skip
    for camera in rig.cameras:
        pixels = camera.project(path_m)
        depth_m = (path_m @ camera.R.T + camera.t)[:, 2]
        video = VideoFile(folder / f"{camera.camera_id}.mkv", SIZE, FPS)
        for time_s, place, depth in zip(times, pixels, depth_m, strict=True):
            video.add(_drawn(place, camera.K[0, 0] * RADIUS_M / depth), float(time_s))
        video.close()
    save_rig(rig, folder / "lenses.toml")
    return folder


def _drawn(place: NDArray[np.float64], radius: float) -> NDArray[np.uint8]:
    image = np.full((SIZE[1], SIZE[0], 3), GREY, dtype=np.uint8)
    x, y, r = (round(float(value) * 2**SUBPIXEL) for value in (*place, radius))
    return np.asarray(cv2.circle(image, (x, y), r, GREEN, -1, cv2.LINE_AA, SUBPIXEL), np.uint8)


def test_ball_places_cameras(rig: Rig, films: Path, capsys: pytest.CaptureFixture[str]) -> None:
    apart_m = float(np.linalg.norm(rig.centers_m[0] - rig.centers_m[1]))
    names = rig.camera_ids
    words = (
        *(films / f"{name}.mkv" for name in names), films / "found.toml",
        "--intrinsics", films / "lenses.toml", "--ball", "green", "--rate", FPS,
        "--distance", f"{names[0]},{names[1]}={apart_m:.4f}m",
    )  # fmt: skip
    assert run("calibrate", "extrinsics", *words) == 0, capsys.readouterr().err
    degrees, millimetres, _ = distances(load_rig(films / "found.toml"), rig, with_scale=False)
    assert degrees < 0.1 and millimetres < 10


def test_ball_that_is_not_there_is_told(films: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sources = [films / f"cam{number}.mkv" for number in range(4)]
    options = (
        "--intrinsics",
        films / "lenses.toml",
        "--ball",
        "pink",
        "--distance",
        "cam0,cam1=3m",
    )
    assert run("calibrate", "extrinsics", *sources, films / "none.toml", *options) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "ball" in error
