"""`e3pose calibrate board` and `intrinsics` as a user runs them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.calibrate.board_pictures import facing, render
from tests.cli.commands import refused, run

from e3pose.calibrate.board import Board
from e3pose.model.camera import Camera
from e3pose.recording.calibration import load_rig

CAMERA = Camera(
    "left", (640, 480), np.array([[600.0, 0, 322], [0, 600, 236], [0, 0, 1]]), np.eye(4)
)
TILTS = [(0.4, 0.1), (-0.4, 0.2), (0.1, 0.5), (0.2, -0.5), (0.3, 0.3), (-0.3, -0.3), (0.5, 0)]


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("board") / "left"
    folder.mkdir()
    board = Board.parse("charuco-5x7-36mm")
    for number, tilts in enumerate(TILTS):
        middle = np.array([0.05 * (number % 3 - 1), 0.03 * (number % 2), 0.45])
        cv2.imwrite(
            str(folder / f"{number}.png"),
            render(CAMERA, board, facing(CAMERA, board, middle, tilts)),
        )
    return folder


def test_board_is_written_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("calibrate", "board", tmp_path / "mine", "--paper", "a3") == 0
    assert (tmp_path / "mine.pdf").read_bytes().startswith(b"%PDF-1.4")
    assert (tmp_path / "mine.svg").read_text().startswith("<svg")
    assert "--board charuco-5x7-54mm" in capsys.readouterr().out
    assert run("calibrate", "board", tmp_path / "mine", "--two-sided") == 0
    assert (tmp_path / "mine-back.svg").read_text() != (tmp_path / "mine.svg").read_text()
    assert run("calibrate", "board", tmp_path / "mine", "--kind", "chessboard") == 0
    assert run("calibrate", "board", tmp_path / "mine", "--square", "60") == 2
    assert "take 300 x 420 mm, expected at most" in capsys.readouterr().err


def test_lenses_are_measured_reported_and_written(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dest, picture = tmp_path / "lenses.toml", tmp_path / "coverage.png"
    assert run("calibrate", "intrinsics", pictures, dest, "--picture", picture) == 0
    printed = capsys.readouterr().out
    assert "left: 640 x 480, 56 degrees across" in printed
    assert "next: record longer: 7 usable views" in printed
    rig = load_rig(dest)
    assert not rig.placed and rig.camera_ids == ("left",)
    assert rig.cameras[0].K[0, 0] == pytest.approx(600, rel=0.01)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert run("calibrate", "intrinsics", f"door={pictures}", dest, "--json", "-") == 0
    (camera,) = json.loads(capsys.readouterr().out)["cameras"]
    assert camera["camera"] == "door" and camera["frames_with_board"] == 7
    assert camera["reprojection_error_px"] < 0.5


def test_what_is_on_the_pictures_is_compared_with_what_is_asked_for(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, dest = tmp_path / "one", tmp_path / "a.toml"
    one.mkdir()
    shutil.copy(pictures / "0.png", one)  # to look for a board that is not there takes long
    for words, named in (
        ((one, dest, "--board", "chessboard-7x12-30mm"), "in 0 frames"),
        ((pictures, pictures, dest), "both name camera 'left'"),
    ):
        assert named in refused(capsys, "calibrate", "intrinsics", *words)
