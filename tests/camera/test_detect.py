from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.base.lock import hold
from e3pose.camera.detect import DetectSettings, detect_videos, partial_folder
from e3pose.camera.provenance import load_provenance
from e3pose.model.camera import Camera, Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import load_recording

WIDTH, HEIGHT = 64, 48
DARKEST, STEP = 20, 10  # of brightness from one frame to the next


def write_video(path: Path, times_ms: Sequence[int], rotation: int = 0) -> Path:
    """A video whose frame i is `DARKEST + STEP * i` bright."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=20)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.gop_size = 6
        stream.codec_context.time_base = stream.time_base = Fraction(1, 1000)
        if rotation:
            stream.set_display_rotation(rotation)
        for i, time_ms in enumerate(times_ms):
            image = np.full((HEIGHT, WIDTH, 3), DARKEST + STEP * i, dtype=np.uint8)
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = time_ms, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


class Brightness:
    """Sees one person whose nose is at x = the number of the frame; nobody in frame 3."""

    skeleton = COCO17

    def __init__(self, stop_after: int | None = None) -> None:
        self.stop_after, self.calls = stop_after, 0

    def detect(self, image: np.ndarray[Any, Any]) -> Poses2D:
        if self.calls == self.stop_after:
            raise KeyboardInterrupt
        self.calls += 1
        number = round((float(image.mean()) - DARKEST) / STEP)
        if number == 3:
            return Poses2D.empty(17)
        keypoints, scores = np.full((1, 17, 2), np.nan), np.zeros((1, 17))
        keypoints[0, 0], scores[0, 0] = (number, image.shape[0]), 0.5
        return Poses2D(keypoints, scores)


def rig(size: tuple[int, int] = (WIDTH, HEIGHT)) -> Rig:
    K = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    return Rig(tuple(Camera(name, size, K, np.eye(4)) for name in ("cam1", "cam2", "cam3")))


def videos(folder: Path) -> list[Path]:
    regular = [50 * i for i in range(20)]
    gap = [t for t in regular if t not in (300, 350)]
    return [write_video(folder / "cam1.mp4", regular), write_video(folder / "cam2.mkv", gap)]


def noses(path: Path, camera_id: str) -> dict[int, float]:
    """Return slot -> x of the nose, -1 where nobody was seen."""
    recording = load_recording(path)
    series = recording.views[recording.rig.index(camera_id)]
    views = {int(slot): series.view(int(slot)) for slot in series.slots}
    return {s: float(v.keypoints_px[0, 0, 0]) if v else -1.0 for s, v in views.items()}


def files(path: Path) -> dict[str, bytes]:
    return {str(p.relative_to(path)): p.read_bytes() for p in path.rglob("*") if p.is_file()}


def test_recording_holds_the_poses_of_every_frame_at_its_time(tmp_path: Path) -> None:
    dest = tmp_path / "out"
    report = detect_videos(videos(tmp_path), rig(), Brightness(), dest)
    expected = {i: -1.0 if i == 3 else float(i) for i in range(20)}
    assert noses(dest, "cam1") == expected
    lost = {slot: x if slot < 6 else x - 2 for slot, x in expected.items() if slot not in (6, 7)}
    assert noses(dest, "cam2") == lost
    recording = load_recording(dest)
    assert recording.rig.camera_ids == ("cam1", "cam2") and report.without_video == ("cam3",)
    assert recording.fps == report.fps == pytest.approx(20, rel=0.01)
    np.testing.assert_allclose(recording.views[0].times_s, np.arange(20) / 20, atol=1e-3)
    assert recording.videos["cam1"] == str(tmp_path / "cam1.mp4")
    assert (report.cameras["cam1"].frames, report.cameras["cam2"].frames) == (20, 18)
    assert report.cameras["cam1"].people == 19
    assert not partial_folder(dest).exists()
    took = recording.processor
    assert {name: each.looks for name, each in took.items()} == {"cam1": 20, "cam2": 18}
    assert all(each.look_s > 0 and each.frame_s > 0 for each in took.values())


class Spot:
    """Sees one person whose nose is the middle of what is bright, in images of a third."""

    skeleton, seen = COCO17, set[tuple[int, ...]]()

    def content_size(self, image_size: tuple[int, int]) -> tuple[int, int]:
        return image_size[0] // 3, image_size[1] // 3

    def detect(self, image: np.ndarray[Any, Any]) -> Poses2D:
        self.seen.add(image.shape)
        bright = image.mean(axis=-1) - image.min()
        y, x = np.indices(bright.shape)
        keypoints, scores = np.full((1, 17, 2), np.nan), np.zeros((1, 17))
        keypoints[0, 0] = (bright * x).sum() / bright.sum(), (bright * y).sum() / bright.sum()
        scores[0, 0] = 0.5
        return Poses2D(keypoints, scores)


@pytest.mark.parametrize("rotation", [0, 90])
def test_keypoints_of_shrunk_frames_are_in_pixels_of_the_film(
    tmp_path: Path, rotation: int
) -> None:
    with av.open(str(tmp_path / "cam1.mp4"), "w") as container:
        stream = container.add_stream("mpeg4", rate=20)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = 96, 48, "yuv420p", 4_000_000
        if rotation:
            stream.set_display_rotation(rotation)
        image = np.full((48, 96, 3), 20, dtype=np.uint8)
        image[30:36, 60:72] = 220  # its middle is 65.5, 32.5
        container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    detector = Spot()
    detector.seen.clear()
    detect_videos([tmp_path / "cam1.mp4"], None, detector, tmp_path / "out")
    nose = load_recording(tmp_path / "out").views[0].keypoints_px[0, 0]
    wanted, size = ((65.5, 32.5), (16, 32, 3)) if not rotation else ((32.5, 29.5), (32, 16, 3))
    assert detector.seen == {size}
    np.testing.assert_allclose(nose, wanted, atol=0.2)


def test_settings_choose_the_frames(tmp_path: Path) -> None:
    dest = tmp_path / "out"
    settings = DetectSettings(
        fps=20, every=2, start_s=0.2, max_slots=4, offsets_s={"cam2": 0.1}, keep_videos="copy"
    )
    detect_videos(videos(tmp_path), rig(), Brightness(), dest, settings)
    assert noses(dest, "cam1") == {0: 4.0, 1: 6.0, 2: 8.0, 3: 10.0}
    # cam2's frame 2 was taken at 0.2 s on the common clock; its frames at 0.4 s and 0.45 s are lost
    assert noses(dest, "cam2") == {0: 2.0, 1: 4.0, 3: 6.0}
    recording = load_recording(dest)
    assert recording.fps == 10
    assert (dest / "videos" / recording.videos["cam2"]).is_file()
    assert load_provenance(dest).video_starts_s == pytest.approx({"cam1": 0.2, "cam2": 0.1})


@each_case("stop_after", [1, 20, 27])
def test_interrupted_run_continues_to_the_same_recording(tmp_path: Path, stop_after: int) -> None:
    inputs, dest = videos(tmp_path), tmp_path / "out"
    detect_videos(inputs, rig(), Brightness(), tmp_path / "straight")
    with pytest.raises(KeyboardInterrupt):
        detect_videos(inputs, rig(), Brightness(stop_after), dest)
    assert not dest.exists() and partial_folder(dest).is_dir()
    again = Brightness()
    seen: list[tuple[int, int]] = []
    report = detect_videos(
        inputs, rig(), again, dest, progress=lambda done, total: seen.append((done, total))
    )
    assert again.calls == 38 - stop_after
    assert seen[-1][0] == seen[-1][1] and abs(seen[-1][1] - 40) <= 1  # an estimate by the headers
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    assert report.resumed_slots >= stop_after
    one, two = files(tmp_path / "straight"), files(dest)
    for name in ("keypoints/cam1.jsonl", "keypoints/cam2.jsonl", "calibration.toml"):
        assert one[name] == two[name]
    assert not partial_folder(dest).exists()


class Beside(Brightness):
    """Has room for other looks beside each of its own, and takes longer for odd frames."""

    threads = 1

    def __init__(self, stop_after: int | None = None) -> None:
        super().__init__(stop_after)
        self.most, self._now, self._lock = 0, 0, threading.Lock()

    def detect(self, image: np.ndarray[Any, Any]) -> Poses2D:
        with self._lock:
            self._now += 1
            self.most = max(self.most, self._now)
            found = super().detect(image)
        time.sleep(0.01 * (round((float(image.mean()) - DARKEST) / STEP) % 2))
        with self._lock:
            self._now -= 1
        return found


def test_looks_beside_each_other_write_the_same_lines_in_order(tmp_path: Path) -> None:
    inputs, dest, three = videos(tmp_path), tmp_path / "out", DetectSettings(threads=3)
    detect_videos(inputs, rig(), Brightness(), tmp_path / "straight")
    one = files(tmp_path / "straight")
    again, alone = Beside(), Beside()
    with pytest.raises(KeyboardInterrupt):
        detect_videos(inputs, rig(), Beside(stop_after=27), dest, three)
    report = detect_videos(inputs, rig(), again, dest, three)
    assert again.most == 3 and 20 <= report.resumed_slots <= 29
    detect_videos(inputs, rig(), alone, tmp_path / "alone", DetectSettings(threads=1))
    assert alone.most == 1
    for made in (dest, tmp_path / "alone"):
        two = files(made)
        for name in ("keypoints/cam1.jsonl", "keypoints/cam2.jsonl"):
            assert one[name] == two[name]
    with pytest.raises(InputError, match="threads: found 0, expected 1 to 1024"):
        detect_videos(inputs, rig(), alone, tmp_path / "none", DetectSettings(threads=0))


@each_case("tail", [b'{"slot":5,"time', b'{"slot":5,"time":0.25,"people":[]}', b"\0"])
def test_torn_last_line_is_detected_again(tmp_path: Path, tail: bytes) -> None:
    inputs, dest = videos(tmp_path), tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        detect_videos(inputs, rig(), Brightness(5), dest)
    with (partial_folder(dest) / "keypoints" / "cam1.jsonl").open("ab") as file:
        file.write(tail)
    detect_videos(inputs, rig(), Brightness(), dest)
    assert noses(dest, "cam1") == {i: -1.0 if i == 3 else float(i) for i in range(20)}


def test_other_settings_do_not_continue_the_work(tmp_path: Path) -> None:
    inputs, dest = videos(tmp_path), tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        detect_videos(inputs, rig(), Brightness(5), dest)
    kept = files(partial_folder(dest))
    for settings, name, words in [
        (DetectSettings(fps=10), "detector", "slots per second: 20, now 10"),
        (DetectSettings(max_slots=3), "detector", "max slots: None, now 3"),
        (None, "another", "model: detector, now another"),
    ]:
        with pytest.raises(InputError, match=words) as caught:
            detect_videos(inputs, rig(), Brightness(), dest, settings, name)
        assert "--overwrite" in str(caught.value)
    assert files(partial_folder(dest)) == kept
    fresh = Brightness()
    detect_videos(inputs, rig(), fresh, dest, DetectSettings(max_slots=3, overwrite=True))
    assert fresh.calls == 6 and noses(dest, "cam1") == {0: 0.0, 1: 1.0, 2: 2.0}


def test_overwrite_continues_and_keeps_the_old_recording_until_the_end(tmp_path: Path) -> None:
    inputs, dest = videos(tmp_path), tmp_path / "out"
    detect_videos(inputs, rig(), Brightness(), dest, DetectSettings(max_slots=2))
    with pytest.raises(InputError, match="--overwrite"):
        detect_videos(inputs, rig(), Brightness(), dest)
    settings = DetectSettings(max_slots=4, overwrite=True)
    with pytest.raises(KeyboardInterrupt):
        detect_videos(inputs, rig(), Brightness(3), dest, settings)
    assert len(noses(dest, "cam1")) == 2
    again = Brightness()
    detect_videos(inputs, rig(), again, dest, settings)
    assert again.calls == 5 and len(noses(dest, "cam1")) == 4


def test_damaged_video_keeps_what_is_readable_and_says_so(tmp_path: Path) -> None:
    inputs, dest = videos(tmp_path), tmp_path / "out"
    whole = inputs[1].read_bytes()
    inputs[1].write_bytes(whole[: int(0.7 * len(whole))])
    report = detect_videos(inputs, rig(), Brightness(), dest)
    assert 0 < report.cameras["cam2"].frames < 18
    assert "header announces" in report.cameras["cam2"].damage
    assert "cam2.mkv: ends after" in load_recording(dest).source
    assert report.num_slots == 20


def test_size_that_is_not_the_calibrations_is_an_error(tmp_path: Path) -> None:
    inputs = videos(tmp_path)
    for size, words in [
        ((100, 48), "found 64x48, expected 100x48"),
        ((48, 64), "sides are swapped"),
    ]:
        with pytest.raises(InputError, match=words) as caught:
            detect_videos(inputs, rig(size), Brightness(), tmp_path / "out")
        assert "cam1" in str(caught.value)
    turned = write_video(tmp_path / "cam1.mp4", [0, 50, 100], rotation=90)
    with pytest.raises(InputError, match="asks players for a quarter turn"):
        detect_videos([turned], rig(), Brightness(), tmp_path / "out")
    detect_videos([turned], rig((HEIGHT, WIDTH)), Brightness(), tmp_path / "out")
    assert load_recording(tmp_path / "out").views[0].keypoints_px[0, 0, 1] == WIDTH


def test_rates_that_differ_need_a_slot_rate(tmp_path: Path) -> None:
    inputs = [
        write_video(tmp_path / "cam1.mp4", range(0, 1000, 50)),
        write_video(tmp_path / "cam2.mp4", range(0, 1000, 100)),
    ]
    with pytest.raises(InputError, match="frame rates differ"):
        detect_videos(inputs, rig(), Brightness(), tmp_path / "out")
    detect_videos(inputs, rig(), Brightness(), tmp_path / "out", DetectSettings(fps=10))
    assert len(noses(tmp_path / "out", "cam1")) == len(noses(tmp_path / "out", "cam2")) == 10


@each_case(
    ("settings", "words"),
    [
        ({"fps": 0.0}, "fps"),
        ({"fps": float("nan")}, "fps"),
        ({"every": 0}, "every"),
        ({"start_s": -1.0}, "start"),
        ({"max_slots": 0}, "max slots"),
        ({"offsets_s": {"cam1": float("nan")}}, "cam1: offset"),
        ({"offsets_s": {"cam9": 1.0}}, "cam9"),
        ({"start_s": 99.0}, "none has a frame"),
    ],
)
def test_wrong_setting_is_named_and_leaves_nothing(
    tmp_path: Path, settings: dict[str, Any], words: str
) -> None:
    inputs = videos(tmp_path)
    before = set(tmp_path.iterdir())
    with pytest.raises(InputError, match=words):
        detect_videos(inputs, rig(), Brightness(), tmp_path / "out", DetectSettings(**settings))
    with pytest.raises(KeyboardInterrupt):  # at the first frame
        detect_videos(inputs, rig(), Brightness(0), tmp_path / "out")
    assert set(tmp_path.iterdir()) == before


def test_second_run_at_the_same_time_and_a_folder_in_the_way_are_refused(tmp_path: Path) -> None:
    inputs, dest = videos(tmp_path), tmp_path / "out"
    with hold(dest), pytest.raises(InputError, match=r"out: process [0-9]+ .*writes there"):
        detect_videos(inputs, rig(), Brightness(), dest)
    partial_folder(dest).mkdir(exist_ok=True)
    (partial_folder(dest) / "diary.txt").write_text("mine")
    with pytest.raises(InputError, match=r"without unfinished\.json"):
        detect_videos(inputs, rig(), Brightness(), dest)
    assert (partial_folder(dest) / "diary.txt").read_text() == "mine"
