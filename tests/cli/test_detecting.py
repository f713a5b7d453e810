from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from tests.cli.commands import refused, run

from e3pose.cli import detecting
from e3pose.model.camera import Camera, Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import load_recording
from e3pose.recording.calibration import save_rig

pytestmark = pytest.mark.slow

WIDTH, HEIGHT, FRAMES = 64, 48, 12


class Interrupted:
    """Sees the brightness of a frame, and ends after so many as Ctrl-C does."""

    skeleton = COCO17

    def __init__(self, frames: int) -> None:
        self.left = frames

    def detect(self, image: np.ndarray[Any, Any]) -> Poses2D:
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        return Poses2D(np.full((1, 17, 2), image.mean()), np.full((1, 17), 0.5))


class Middle:
    skeleton = COCO17

    def detect(self, image: np.ndarray[Any, Any]) -> Poses2D:
        return Poses2D(np.full((1, 17, 2), 24.0), np.full((1, 17), 0.5))


def site(folder: Path, names: Sequence[str] = ("cam1", "cam2")) -> list[str]:
    """Make videos and a calibration; return the words that say so."""
    K = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    rig = Rig(tuple(Camera(name, (WIDTH, HEIGHT), K, np.eye(4)) for name in ("cam1", "cam2")))
    save_rig(rig, folder / "rig.toml")
    for name in names:
        with av.open(str(folder / f"{name}.mp4"), "w") as container:
            stream = container.add_stream("mpeg4", rate=20)
            stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
            stream.time_base = Fraction(1, 20)
            for i in range(FRAMES):
                image = np.full((HEIGHT, WIDTH, 3), 20 + 10 * i, dtype=np.uint8)
                container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
            container.mux(stream.encode())
    return [*(str(folder / f"{n}.mp4") for n in names), "--calibration", str(folder / "rig.toml")]


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detecting, "_detector", lambda *_: (Middle(), "middle"))


def test_videos_then_destination(
    tmp_path: Path, fake: None, capsys: pytest.CaptureFixture[str]
) -> None:
    one, two, *rest = site(tmp_path)
    assert run("detect", one, f"cam2={two}", str(tmp_path / "out"), *rest, "--every", "2") == 0
    recording = load_recording(tmp_path / "out")
    assert recording.num_slots == FRAMES // 2 and recording.fps == 10
    text = capsys.readouterr().out
    assert "6 slots at 10 per second" in text and "cam2: 6 frames, 6 people" in text


def test_options_reach_the_recording(
    tmp_path: Path, fake: None, capsys: pytest.CaptureFixture[str]
) -> None:
    one, *rest = site(tmp_path, ["cam1"])
    words = ("--fps", 20, "--start", 0.1, "--max-slots", 5, "--offset", "cam1=-0.05")
    assert run("detect", one, tmp_path / "out", *rest, *words, "--link-videos") == 0
    recording = load_recording(tmp_path / "out")
    assert recording.num_slots == 5
    link = tmp_path / "out" / "videos" / recording.videos["cam1"]
    assert link.is_symlink() and link.resolve() == tmp_path / "cam1.mp4"
    assert "skipped, no video: cam2" in capsys.readouterr().out
    for option, value, message in (
        ("--start", 1000, "none has a frame"),
        ("--offset", "cam7=1", "'cam7', which is not in the rig"),
        ("--rotation", "cam7=90", "'cam7', which is not in the rig"),
    ):
        assert message in refused(capsys, "detect", one, tmp_path / "none", *rest, option, value)
        assert not [*tmp_path.glob("none*")]


def test_interrupted_run_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = site(tmp_path)
    words.insert(2, str(tmp_path / "out"))
    detector = Interrupted(5)
    monkeypatch.setattr(detecting, "_detector", lambda *_: (detector, "bright"))
    assert run("detect", *words) == 130
    error = capsys.readouterr().err
    assert "out.partial keeps the work" in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()
    detector.left = 2 * FRAMES - 5
    assert run("detect", *words) == 0
    assert detector.left == 0, "nothing is looked at again"
    for series in load_recording(tmp_path / "out").views:
        assert series.slots.tolist() == list(range(FRAMES))
        levels = series.keypoints_px[:, 0, 0]
        np.testing.assert_allclose(levels, 20 + 10 * np.arange(FRAMES), atol=3)
    assert not (tmp_path / "out.partial").exists()


@pytest.mark.shared
def test_network_file_is_recognised(tmp_path: Path, shared: Path) -> None:
    folder = shared / "models"
    one, *rest = site(tmp_path, ["cam1"])
    path = str(folder / "movenet-multipose/movenet_multipose_lightning_dynamic.onnx")
    words = ["--model", path, "--max-slots", "2", "--threads", "1"]
    assert run("detect", one, str(tmp_path / "out"), *rest, *words) == 0
    recording = load_recording(tmp_path / "out")
    assert recording.skeleton.name == "coco17" and recording.num_slots == 2
