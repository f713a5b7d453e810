"""Folders of numbered images in the place of videos."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.manual_clock import ManualClock

from e3pose.base.errors import InputError
from e3pose.base.jpeg import MOST_SCANS, jpeg_size
from e3pose.calibrate import board_views
from e3pose.camera import phone
from e3pose.camera.detect import DetectSettings, detect_videos
from e3pose.camera.live_source import make_source
from e3pose.camera.phone import PhoneSource
from e3pose.camera.source import ImageFolder, open_sources, read_picture
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17, Skeleton
from e3pose.recording import load_recording

NUMBERS = {"Camera0": (3, 4, 6), "Camera1": (4, 5, 6)}


class Brightness:
    """Finds one person whose first coordinate is the brightness of red."""

    skeleton: Skeleton = COCO17

    def detect(self, image: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> Poses2D:
        return Poses2D(np.full((1, 17, 2), float(image[0, 0, 0])), np.ones((1, 17)))


@pytest.fixture
def folders(tmp_path: Path) -> dict[str, Path]:
    for name, numbers in NUMBERS.items():
        (tmp_path / name).mkdir()
        for number in numbers:
            image = np.zeros((48, 64, 3), dtype=np.uint8)
            image[..., 2] = 10 * number  # red, as OpenCV writes it
            cv2.imwrite(str(tmp_path / name / f"img_{number:06d}.png"), image)
        (tmp_path / name / "readme.txt").write_text("not an image")
    return {name: tmp_path / name for name in NUMBERS}


def test_numbers_are_times(folders: dict[str, Path]) -> None:
    opened = open_sources(folders, 25.0)
    source = opened["Camera1"]
    assert isinstance(source, ImageFolder) and source.image_size == (64, 48)
    assert [frame.time_s * 25 for frame in source.frames()] == pytest.approx([1, 2, 3])
    assert [frame.image[0, 0, 0] for frame in source.frames(0.06)] == [50, 60]


def test_folders_become_a_recording(folders: dict[str, Path], tmp_path: Path) -> None:
    dest = tmp_path / "found"
    report = detect_videos(
        list(folders.values()), None, Brightness(), dest, DetectSettings(fps=25.0)
    )
    assert report.num_slots == 4 and report.fps == 25.0
    recording = load_recording(dest)
    assert recording.videos == {}
    found = [[recording.view(slot, camera) for slot in range(4)] for camera in range(2)]
    values = [[None if v is None else int(v.keypoints_px[0, 0, 0]) for v in row] for row in found]
    assert values == [[30, 40, None, 60], [None, 40, 50, 60]]


def test_what_is_wrong_is_named(folders: dict[str, Path], tmp_path: Path) -> None:
    small = folders["Camera0"] / "img_7.png"
    cv2.imwrite(str(small), np.zeros((10, 10, 3), np.uint8))
    source = open_sources(folders, 25.0)["Camera0"]
    assert isinstance(source, ImageFolder)
    with pytest.raises(InputError, match=r"img_7\.png: image size: found 10x10, expected 64x48"):
        [*source.frames()][-1].image  # noqa: B018
    small.unlink()
    with pytest.raises(InputError, match="--fps: missing: the frame rate of the image folders"):
        open_sources(folders, None)
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match="empty: found no image"):
        open_sources({"a": empty}, 25.0)
    (folders["Camera0"] / "img_000003.png").write_bytes(b"")
    with pytest.raises(InputError, match=r"img_000003\.png: cannot be read as an image"):
        open_sources(folders, 25.0)
    cv2.imwrite(str(folders["Camera1"] / "img_6.png"), np.zeros((48, 64, 3), np.uint8))
    with pytest.raises(InputError, match="number 6 appears twice"):
        open_sources(folders, 25.0)


def many_scans(count: int) -> bytes:
    """Return a progressive JPEG that goes over the picture so many times."""
    coded = cv2.imencode(
        ".jpg", np.zeros((48, 64, 3), np.uint8), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]
    )[1].tobytes()
    at = [one.start() for one in re.finditer(b"\xff\xda", coded)]
    return coded[:-2] + coded[at[-1] : -2] * (count - len(at)) + coded[-2:]


@pytest.mark.parametrize("hostile", ["scans", "pixels"])
def test_no_door_decodes_a_picture_that_takes_too_much(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hostile: str
) -> None:
    """30 kB with 400 scans took a decoder 11 s, a PNG of 1 kB states gigabytes."""
    png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + 2 * (60_000).to_bytes(4, "big")
    data = many_scans(400) if hostile == "scans" else png
    assert jpeg_size(many_scans(MOST_SCANS)) == (64, 48)
    folder = tmp_path / "cam0"
    folder.mkdir()
    for number in range(3):
        (folder / f"{number}.{'jpg' if hostile == 'scans' else 'png'}").write_bytes(data)
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("it was decoded"))
    doors: tuple[Callable[[], object], ...] = (
        lambda: read_picture(min(folder.iterdir())),
        lambda: open_sources({"cam0": folder}, 25.0),
        lambda: make_source(str(folder), "cam0", ManualClock(), 25.0),
        lambda: list(board_views._pictures(folder, None)),
        lambda: PhoneSource(tmp_path / "phone.json", ManualClock()).take(data, None, None),
        lambda: jpeg_size(data),  # what pages check before a browser decodes
    )
    for door in doors:
        with pytest.raises(InputError, match=r"scans|pixels|no JPEG"):
            door()
    assert not phone._decoded(data, (64, 48)).any(), "a phone's picture is black then"
