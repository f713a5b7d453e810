"""What a live camera sees becomes videos of bounded length and size, with the times of frames."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.waiting import eventually

from e3pose.base.clock import SlotTimes
from e3pose.camera import video_recorder
from e3pose.camera.base import LiveFrame
from e3pose.camera.source import open_video
from e3pose.camera.video_recorder import QUEUE_FRAMES, VideoFile, VideoRecorder, VideoSettings
from e3pose.model.pose import Poses2D
from e3pose.recording.videos import begin_of, videos_in

BEGIN_NS = 1_800_000_000 * 10**9
FPS = 20.0
TIMES = SlotTimes(BEGIN_NS, round(1e9 / FPS))
SIZE = (96, 64)


def frame(slot: int, jitter_ms: int = 0) -> tuple[LiveFrame, int]:
    """Return a frame as bright as its slot, and when it was taken."""
    image = np.full((SIZE[1], SIZE[0], 3), slot % 200 + 20, dtype=np.uint8)
    edge_ns = TIMES.middle_ns(slot) + jitter_ms * 10**6
    return LiveFrame(edge_ns, SIZE, lambda: image), edge_ns


def record(
    settings: VideoSettings, slots: Sequence[int], jitter_ms: int = 0
) -> tuple[VideoRecorder, list[str]]:
    messages: list[str] = []
    recorder = VideoRecorder(settings, messages.append)
    for number, slot in enumerate(slots):
        recorder.offer(*frame(slot, jitter_ms * (slot % 3)), 7, slot, TIMES)
        assert eventually(lambda done=number + 1: recorder.recorded == done)  # type: ignore[misc]
    recorder.close()
    return recorder, messages


def test_frames_keep_their_times_and_their_content(tmp_path: Path) -> None:
    slots = [100, 101, 102, 105, 106, 110]
    recorder, messages = record(VideoSettings(tmp_path / "videos", "cam1"), slots, jitter_ms=4)
    assert messages == [] and recorder.dropped == 0 and recorder.busy_s > 0
    (path,) = videos_in(tmp_path / "videos")
    assert path.name == "cam1-20270115T080005.004000Z.mkv"
    assert path.stat().st_mode & 0o077 == 0  # nobody else may see it
    taken_ns = [TIMES.middle_ns(slot) + 4_000_000 * (slot % 3) for slot in slots]
    assert begin_of(path) == taken_ns[0]
    video = open_video(path)
    assert video.image_size == SIZE and video.rate == pytest.approx(FPS)
    frames = list(video.frames())
    expected_s = [(ns - taken_ns[0]) / 1e9 for ns in taken_ns]
    assert [f.time_s for f in frames] == pytest.approx(expected_s, abs=0.6e-3)
    grey = [float(f.image.mean()) for f in frames]
    assert grey == pytest.approx([slot % 200 + 20 for slot in slots], abs=3)


def test_videos_begin_where_recordings_do(tmp_path: Path) -> None:
    record(VideoSettings(tmp_path, "cam1", part_s=1.0), range(110, 150))
    lengths = [len(list(open_video(path).frames())) for path in videos_in(tmp_path)]
    assert lengths == [10, 20, 10]  # parts of 20 slots begin at slots 120 and 140


def test_pace_is_taken_out_of_the_times(tmp_path: Path) -> None:
    record(VideoSettings(tmp_path, "cam1", pace=0.5), range(10))
    (path,) = videos_in(tmp_path)
    video = open_video(path)
    assert [f.time_s for f in video.frames()] == pytest.approx(
        [k / 40 for k in range(10)], abs=1e-3
    )
    assert video.rate == pytest.approx(2 * FPS)


def test_oldest_videos_make_room(tmp_path: Path) -> None:
    record(VideoSettings(tmp_path, "cam1", part_s=1.0), range(20))
    size = sum(path.stat().st_size for path in videos_in(tmp_path))
    asked = VideoSettings(tmp_path, "cam1", part_s=1.0, max_bytes=round(2.5 * size))
    record(asked, range(100, 200))
    left = videos_in(tmp_path)
    assert 1 <= len(left) <= 3 and (begin_of(left[-1]) or 0) == TIMES.middle_ns(180)
    assert sum(path.stat().st_size for path in left) <= 3.5 * size


def test_slow_disk_loses_frames_of_the_video_and_never_waits(tmp_path: Path) -> None:
    messages: list[str] = []
    recorder = VideoRecorder(VideoSettings(tmp_path, "cam1"), messages.append)
    busy, free = threading.Event(), threading.Event()

    def slow() -> np.ndarray:
        busy.set()
        assert free.wait(60)
        return np.zeros((64, 96, 3), dtype=np.uint8)

    recorder.offer(LiveFrame(0, SIZE, slow), TIMES.middle_ns(0), 7, 0, TIMES)
    assert busy.wait(60)
    for slot in range(1, QUEUE_FRAMES + 4):
        recorder.offer(*frame(slot), 7, slot, TIMES)  # returns, though nothing is written
    assert recorder.dropped == 3
    free.set()
    recorder.close()
    assert recorder.recorded == QUEUE_FRAMES + 1
    assert messages == ["video: frames are left out, encoder or disk is too slow"]


def test_source_without_images_is_reported_once(tmp_path: Path) -> None:
    messages: list[str] = []
    recorder = VideoRecorder(VideoSettings(tmp_path, "cam1"), messages.append)
    for slot in range(3):
        shown = LiveFrame(0, SIZE, lambda: Poses2D.empty(17))
        recorder.offer(shown, TIMES.middle_ns(slot), 7, slot, TIMES)
    recorder.close()
    assert messages == ["not recording video: the source has keypoints, no images"]
    images = [object(), object()]
    shared = LiveFrame(0, SIZE, images.pop).shared()
    assert shared.image() is shared.image() and len(images) == 1
    assert videos_in(tmp_path) == []


def test_full_disk_is_reported_and_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = True

    class Disk(VideoFile):
        def __init__(self, path: Path, image_size: tuple[int, int], fps: float) -> None:
            if full:
                raise OSError(28, "No space left on device")
            super().__init__(path, image_size, fps)

    monkeypatch.setattr(video_recorder, "VideoFile", Disk)
    messages: list[str] = []
    recorder = VideoRecorder(VideoSettings(tmp_path, "cam1"), messages.append)
    recorder.offer(*frame(0), 7, 0, TIMES)
    assert eventually(lambda: bool(messages))
    full = False
    recorder.offer(*frame(1), 7, 1, TIMES)  # too early to try again
    later = round(video_recorder.RETRY_S * FPS) + 1
    recorder.offer(*frame(later), 7, later, TIMES)
    recorder.close()
    assert messages == ["not recording video: no space left on device", "recording video again"]
    assert recorder.recorded == 1


KILLED = """
import sys, time
from pathlib import Path
import numpy as np
from e3pose.camera.video_recorder import VideoFile
video = VideoFile(Path(sys.argv[1]), (96, 64), 20.0)
for slot in range(200):
    video.add(np.full((64, 96, 3), slot, dtype=np.uint8), slot / 20)
print("written", flush=True)
time.sleep(600)
"""


def test_video_of_a_killed_program_lacks_its_last_second_at_most(tmp_path: Path) -> None:
    path = tmp_path / "cam1-20270115T080000.000000Z.mkv"
    program = subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE)
    with program:
        assert program.stdout is not None and program.stdout.readline() == b"written\n"
        program.kill()
    video = open_video(path)
    times_s = [shown.time_s for shown in video.frames()]
    assert times_s[-1] >= 199 / 20 - 1.0 and times_s == pytest.approx(
        [k / 20 for k in range(len(times_s))], abs=1e-3
    )
    assert next(iter(video.frames(5.0))).time_s == pytest.approx(5.0, abs=1e-3)
