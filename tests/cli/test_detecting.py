from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from tests.cli.commands import refused, run
from tests.distributions import ROOT

from e3pose.cli import detecting
from e3pose.model.camera import Camera, Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import load_recording
from e3pose.recording.calibration import save_rig

pytestmark = pytest.mark.slow

WIDTH, HEIGHT, FRAMES = 64, 48, 12

# Detects in 0.1 s, so that a run can be stopped halfway.
SLOW = """
import sys, time
from tests.cli.test_detecting import Brightness
from e3pose.cli import detecting, main

class Slow(Brightness):
    def detect(self, image):
        time.sleep(0.1)
        return super().detect(image)

detecting._detector = lambda *_: (Slow([]), "slow")
main(sys.argv[1:])
"""


class Brightness:
    """Sees the brightness of a frame."""

    skeleton = COCO17

    def __init__(self, seen: list[float]) -> None:
        self.seen = seen

    def detect(self, image: np.ndarray[Any, Any]) -> Poses2D:
        self.seen.append(round(float(image.mean())))
        return Poses2D(np.full((1, 17, 2), self.seen[-1]), np.full((1, 17), 0.5))


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


def slow(words: Sequence[str]) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", SLOW, "detect", *words],
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )


def wait_for_lines(partial: Path, count: int) -> None:
    """Return when the unfinished work holds so many lines."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        if sum(p.read_bytes().count(b"\n") for p in partial.glob("keypoints/*.jsonl")) >= count:
            return
        time.sleep(0.02)
    raise AssertionError("no line was written")


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
    words = [
        "--fps",
        "20",
        "--start",
        "0.1",
        "--max-slots",
        "5",
        "--offset",
        "cam1=-0.05",
        "--link-videos",
    ]
    assert run("detect", one, str(tmp_path / "out"), *rest, *words) == 0
    recording = load_recording(tmp_path / "out")
    assert recording.num_slots == 5
    link = tmp_path / "out" / "videos" / recording.videos["cam1"]
    assert link.is_symlink() and link.resolve() == tmp_path / "cam1.mp4"
    assert "skipped, no video: cam2" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--offset", "cam1"], "CAMERA=SECONDS"),
        (["--offset", "cam1=soon"], "CAMERA=SECONDS"),
        (["--offset", "cam7=1"], "'cam7', which is not in the rig"),
        (["--link-videos", "--copy-videos"], "at most one"),
        (["--fps", "0"], "fps"),
        (["--every", "0"], "every"),
        (["--start", "1000"], "none has a frame"),
    ],
)
def test_wrong_option_is_one_line_and_code_2(
    tmp_path: Path,
    fake: None,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    expected: str,
) -> None:
    one, two, *rest = site(tmp_path)
    before = set(tmp_path.iterdir())
    assert expected in refused(capsys, "detect", one, two, tmp_path / "out", *rest, *words)
    assert set(tmp_path.iterdir()) == before


@pytest.mark.parametrize("option", ["--model", "--family"])
def test_unknown_model_or_family_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str
) -> None:
    one, two, *rest = site(tmp_path)
    words = [option, "nonsense"] + (["--model", "x.onnx"] if option == "--family" else [])
    assert "nonsense" in refused(capsys, "detect", one, two, tmp_path / "out", *rest, *words)


def test_killed_and_interrupted_run_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = site(tmp_path)
    words.insert(2, str(tmp_path / "out"))
    partial = tmp_path / "out.partial"
    process = slow(words)
    wait_for_lines(partial, 5)
    process.kill()
    process.communicate()
    done = sum(p.read_bytes().count(b"\n") for p in partial.glob("keypoints/*.jsonl"))
    assert 5 <= done < 2 * FRAMES and not (tmp_path / "out").exists()
    process = slow(words)
    wait_for_lines(partial, done + 2)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "out.partial keeps the work" in error and error.count("\n") == 1
    looked = list[float]()
    monkeypatch.setattr(detecting, "_detector", lambda *_: (Brightness(looked), "slow"))
    assert run("detect", *words) == 0
    assert 0 < len(looked) <= 2 * FRAMES - done - 2, "nothing is looked at again"
    recording = load_recording(tmp_path / "out")
    for series in recording.views:
        assert series.slots.tolist() == list(range(FRAMES))
        levels = series.keypoints_px[:, 0, 0]
        np.testing.assert_allclose(levels, 20 + 10 * np.arange(FRAMES), atol=3)
    assert not partial.exists()


@pytest.mark.shared
@pytest.mark.skipif(not os.environ.get("E3POSE_SHARED"), reason="E3POSE_SHARED is not set")
def test_network_file_is_recognised(tmp_path: Path) -> None:
    folder = Path(os.environ["E3POSE_SHARED"]) / "models"
    one, *rest = site(tmp_path, ["cam1"])
    path = str(folder / "movenet-multipose/movenet_multipose_lightning_dynamic.onnx")
    words = ["--model", path, "--max-slots", "2", "--threads", "1"]
    assert run("detect", one, str(tmp_path / "out"), *rest, *words) == 0
    recording = load_recording(tmp_path / "out")
    assert recording.skeleton.name == "coco17" and recording.num_slots == 2
