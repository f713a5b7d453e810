"""`e3pose detect` on films of a camera that is mounted on its side."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cli.commands import run
from tests.rigs import looking

from e3pose.camera.orientation import Orientation
from e3pose.camera.provenance import load_provenance
from e3pose.cli import detecting
from e3pose.detectors.base import Image
from e3pose.detectors.drawn import Drawn, draw
from e3pose.detectors.focus import Part
from e3pose.evaluate.detect_again import open_pixels
from e3pose.model.camera import Camera, Rig
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.recording import load_recording
from e3pose.recording.calibration import save_rig

FRAMES, DEGREES = 4, 90
SIZE = (240, 320)  # of the upright film
BACK = Orientation.from_degrees(360 - DEGREES)  # makes people lie as the camera does


class Upright(Drawn):
    """Finds people whose nose is above their ankles, like a network that never saw others."""

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        poses = super().detect_part(image, part, expected)
        rows = poses.keypoints_px[:, :, 1]
        stands = rows[:, 15] - rows[:, 0] > np.ptp(poses.keypoints_px[:, :, 0], axis=1)
        return Poses2D(poses.keypoints_px[stands], poses.scores[stands])


def write_film(path: Path, images: list[NDArray[np.uint8]]) -> Path:
    """Write a film without loss."""
    height, width = images[0].shape[:2]
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=10)
        stream.width, stream.height, stream.pix_fmt = width, height, "bgr0"
        stream.time_base = Fraction(1, 10)
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    return path


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with a film of a camera that stands, `cam1`, and of one that lies."""
    monkeypatch.setattr(detecting, "_detector", lambda *_: (Upright(), "drawn"))
    along = np.linspace(0, 1, 17)
    person = np.stack([90 + 40 * np.sin(9 * along), 40 + 220 * along], axis=-1)
    empty = np.full((SIZE[1], SIZE[0], 3), 24, dtype=np.uint8)
    images = [draw(empty, [person + (8 * i, 3 * i)]) for i in range(FRAMES)]
    write_film(tmp_path / "cam1.mkv", images)
    write_film(tmp_path / "cam2.mkv", [BACK.apply(image) for image in images])
    cameras = [
        Camera(name, size, camera.K, camera.T_world_camera)
        for name, size, camera in zip(
            ("cam1", "cam2"), (SIZE, SIZE[::-1]), looking((4, 0), (0, 4)).cameras, strict=True
        )
    ]
    save_rig(Rig(tuple(cameras)), tmp_path / "rig.toml")
    return tmp_path


def detect(folder: Path, name: str, *options: str) -> Path:
    """Detect in both films; return the recording."""
    words = (str(folder / "cam1.mkv"), str(folder / "cam2.mkv"), str(folder / name))
    assert run("detect", *words, "--calibration", str(folder / "rig.toml"), *options) == 0
    return folder / name


def found(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return `(num_frames, 17, 2)` keypoints of the camera that stands and of the one that lies."""
    one, two = (series.keypoints_px for series in load_recording(path).views)
    return one, two


def mark_turned(folder: Path) -> None:
    """Make the calibration one of Caliscope's, which says that `cam2` is turned."""
    text = (folder / "rig.toml").read_text()
    turned = text.replace('name = "cam2"', 'name = "cam2"\nrotation_count = 1')
    (folder / "rig.toml").write_text(turned)


@pytest.mark.parametrize(
    "options",
    [(), pytest.param(("--feedback",), marks=pytest.mark.slow)],  # it compiles
)
def test_lying_film_has_the_keypoints_of_the_upright_one_in_its_own_pixels(
    folder: Path, options: tuple[str, ...]
) -> None:
    path = detect(folder, "out", "--rotation", f"cam2={DEGREES}", *options)
    upright_px, lying_px = found(path)
    assert len(upright_px) == len(lying_px) == FRAMES
    np.testing.assert_allclose(lying_px, BACK.points(upright_px, *SIZE), atol=1e-6)
    assert load_provenance(path).rotations == {"cam2": DEGREES}


def test_without_rotation_nobody_is_found_in_the_lying_film(folder: Path) -> None:
    upright_px, lying_px = found(detect(folder, "out"))
    assert len(upright_px) == FRAMES and len(lying_px) == 0


def test_rotation_of_caliscope_is_used_and_reported(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mark_turned(folder)
    upright_px, lying_px = found(detect(folder, "out"))
    np.testing.assert_allclose(lying_px, BACK.points(upright_px, *SIZE), atol=1e-6)
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "turned" in line]
    assert str(folder / "rig.toml") in line and "cam2 90 degrees" in line
    assert len(found(detect(folder, "not", "--rotation", "cam2=0"))[1]) == 0
    assert "turned" not in capsys.readouterr().out


def test_detecting_anew_turns_images_as_before(folder: Path) -> None:
    path = detect(folder, "out", "--rotation", f"cam2={DEGREES}")
    (path / "own.py").write_text("from tests.cli.test_detecting_turned import Upright as Upright\n")
    read_view = open_pixels(load_recording(path), path, f"{path}/own.py:Upright")
    again = read_view(1, 1, None)
    assert again is not None
    np.testing.assert_allclose(again.keypoints_px[0], found(path)[1][1], atol=1e-3)


def test_work_begun_with_another_rotation_is_not_continued(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Stops(Upright):
        calls = 0

        def detect(self, image: Image) -> Poses2D:
            self.calls += 1
            if self.calls == 3:
                raise OSError("the disk is gone")
            return super().detect(image)

    words = [str(folder / f"cam{i}.mkv") for i in (1, 2)] + [str(folder / "out")]
    with monkeypatch.context() as patch:
        patch.setattr(detecting, "_detector", lambda *_: (Stops(), "drawn"))
        run("detect", *words)
    assert run("detect", *words, "--rotation", "cam2=90") == 2
    assert "rotation of cam2: none, now 90 degrees" in capsys.readouterr().err
