"""Balls in films place cameras, one or a wand of two: films of a simulated rig, encoded."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from tests.calibrate.people_scenes import distances
from tests.cases import each_case
from tests.cli.commands import run

from e3pose.camera.video_recorder import VideoFile
from e3pose.model.camera import Rig
from e3pose.model.rigs import ring_rig
from e3pose.recording.calibration import load_rig, save_rig

pytestmark = pytest.mark.slow

SIZE, FPS, SECONDS = (480, 360), 8.0, 15.0
RADIUS_M = 0.06
GREEN, RED, GREY = (20, 190, 60), (210, 30, 40), 110
WAND_M = 0.5
SUBPIXEL = 4  # bits of OpenCV's fixed-point coordinates


@pytest.fixture(scope="module")
def rig() -> Rig:
    return ring_rig(4, 4.0, 2.2, SIZE, np.random.default_rng(751))


@pytest.fixture(scope="module")
def films(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Films of a wand that is turned and carried through the room, a green and a red ball."""
    folder = tmp_path_factory.mktemp("films")
    times = np.arange(0, SECONDS, 1 / FPS)
    path_m = np.stack([
        1.6 * np.sin(0.9 * times), 1.6 * np.sin(1.3 * times + 1), 1.1 + 0.8 * np.sin(0.7 * times)
    ], axis=-1)  # fmt: skip
    around, up = 0.8 * times, 0.9 * np.sin(0.5 * times)
    along = np.stack([
        np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)
    ], axis=-1)  # fmt: skip
    balls_m = np.stack([path_m, path_m + WAND_M * along])
    for camera in rig.cameras:
        pixels = camera.project(balls_m)
        depth_m = (balls_m @ camera.R.T + camera.t)[..., 2]
        video = VideoFile(folder / f"{camera.camera_id}.mkv", SIZE, FPS)
        for index, time_s in enumerate(times.tolist()):
            image = np.full((SIZE[1], SIZE[0], 3), GREY, dtype=np.uint8)
            for ball in np.argsort(-depth_m[:, index]).tolist():  # the nearer one hides the other
                radius = camera.K[0, 0] * RADIUS_M / depth_m[ball, index]
                draw(image, pixels[ball, index], radius, (GREEN, RED)[ball])
            video.add(image, time_s)
        video.close()
    save_rig(rig, folder / "lenses.toml")
    return folder


def draw(
    image: NDArray[np.uint8],
    place: NDArray[np.float64],
    radius: float,
    colour: tuple[int, int, int],
) -> None:
    x, y, r = (round(float(value) * 2**SUBPIXEL) for value in (*place, radius))
    cv2.circle(image, (x, y), r, colour, -1, cv2.LINE_AA, SUBPIXEL)


def test_wand_places_cameras_in_metres(
    rig: Rig, films: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = (
        *(films / f"{name}.mkv" for name in rig.camera_ids), films / "wand.toml",
        "--intrinsics", films / "lenses.toml", "--wand", "green,red=50cm", "--rate", FPS,
    )  # fmt: skip
    assert run("calibrate", "extrinsics", *words) == 0, capsys.readouterr().err
    assert "scale: a wand of 500 mm" in capsys.readouterr().out
    found = load_rig(films / "wand.toml")
    degrees, millimetres, _ = distances(found, rig, with_scale=False)
    assert degrees < 0.1 and millimetres < 10
    assert abs(distances(found, rig)[2] - 1) < 0.002


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


@each_case(
    ("options", "message"),
    [
        (("--ball", "pink", "--distance", "cam0,cam1=3m"), "ball"),
        (("--wand", "green,mauve=50cm"), "--wand: found 'mauve', expected one of bright, red"),
        (("--wand", "green,pink=50cm"), "two of its markers were placed at "),
    ],
)
def test_balls_that_are_not_there_are_reported(
    films: Path, options: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    sources = [films / f"cam{number}.mkv" for number in range(4)]
    lenses = ("--intrinsics", films / "lenses.toml", "--rate", FPS / 4)
    assert run("calibrate", "extrinsics", *sources, films / "none.toml", *lenses, *options) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and message in error
