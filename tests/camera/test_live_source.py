"""Sources of a live camera: what they show when, and what they refuse."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.clock import WallClock
from e3pose.base.errors import InputError
from e3pose.camera.live_source import Loop, PacedSource, make_source, slower
from e3pose.recording import save_recording
from e3pose.simulate import DetectorSettings, SceneSettings, simulate

FAST = 100.0  # frames per second


def numbers(start_s: float) -> Iterator[tuple[float, Callable[[], Any]]]:
    """Ten frames, each of which shows its number."""
    for number in range(round(start_s * FAST + 0.499), 10):
        yield number / FAST, lambda number=number: number  # type: ignore[misc]


LOOP = Loop(FAST, (64, 48), 10 / FAST, numbers)


@dataclass
class Shifted:
    """The time, so shifted that it is `at_ns` when somebody first asks; a test may add to it."""

    at_ns: int
    asked_ns: int | None = None

    def now_ns(self) -> int:
        now_ns = time.monotonic_ns()
        self.asked_ns = now_ns if self.asked_ns is None else self.asked_ns
        return self.at_ns + now_ns - self.asked_ns

    def wait(self, event: Any, until_ns: int) -> bool:
        return bool(event.wait(max(0.0, (until_ns - self.now_ns()) / 1e9)))


def shown(source: PacedSource, count: int) -> list[int]:
    source.open()
    frames = [source.read() for _ in range(count)]
    source.close()
    return [frame.image() for frame in frames if frame is not None]


def test_round_begins_where_the_time_of_day_says() -> None:
    # 1.73 s are 17 rounds of 0.1 s and 3 frames.
    assert shown(PacedSource(LOOP, Shifted(1_725_000_000)), 10) == [3, 4, 5, 6, 7, 8, 9, 0, 1, 2]


def test_nothing_is_shown_before_the_beginning() -> None:
    clock = Shifted(10_000_000_000)
    source = PacedSource(LOOP, clock, begin_s=10.05)
    source.open()
    frame = source.read()
    assert frame is not None and frame.image() == 0
    assert frame.captured_ns == 10_050_000_000 and clock.now_ns() >= 10_050_000_000


def test_slower_loop_shows_the_same_frames_at_longer_intervals() -> None:
    loop = slower(LOOP, 0.5)
    assert loop.fps == 50 and loop.length_s == pytest.approx(0.2)
    times = [at_s for at_s, _ in loop.frames(0.0)]
    assert np.diff(times) == pytest.approx(0.02)
    # In the middle of the longer round the same frame is next as in the middle of the shorter.
    assert [look() for _, look in loop.frames(0.1)] == [look() for _, look in LOOP.frames(0.05)]


def test_frames_that_are_late_already_are_left_out() -> None:
    clock = Shifted(2_000_000_000)
    source = PacedSource(LOOP, clock)
    source.open()
    clock.at_ns += 1_200_000_000  # a machine that was busy: a second and more behind
    before_ns = clock.now_ns()
    frame = source.read()
    assert frame is not None
    assert before_ns - frame.captured_ns <= 1e9


def test_recording_shows_its_keypoints_at_its_pace(tmp_path: Path) -> None:
    scene = SceneSettings(
        people=1, seconds=1.0, fps=50, cameras=2, detector=DetectorSettings(perfect=True)
    )
    recording = simulate(scene, 0)
    save_recording(recording, tmp_path / "walk")
    source = make_source(f"recorded:{tmp_path / 'walk'}", "cam1", WallClock(), None, 0.5)
    assert source.fps == 25
    source.open()
    frame = source.read()
    assert frame is not None
    assert frame.poses is not None
    poses = frame.poses()
    seen = [recording.view(slot, 1) for slot in range(recording.num_slots)]
    assert any(v is not None and np.array_equal(v.scores, poses.scores) for v in seen)


def test_folder_of_images_is_shown_in_order(tmp_path: Path) -> None:
    for number in range(3):
        image = np.full((8, 8, 3), 50 * (number + 1), dtype=np.uint8)
        cv2.imwrite(str(tmp_path / f"{number}.png"), image)
    source = make_source(str(tmp_path), "cam1", Shifted(3_000_000_000), 50.0)
    source.open()
    frames = [source.read() for _ in range(3)]
    assert [int(f.image()[0, 0, 0]) for f in frames if f is not None] == [50, 100, 150]


@each_case(
    ("name", "message"),
    [
        ("usb:front", "expected usb:by-id/NAME"),
        ("none.mp4", "none.mp4"),
        ("recorded:nowhere", "nowhere"),
    ],
)
def test_source_that_cannot_be_is_refused(name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_source(name, "cam1", WallClock(), None)


@each_case("name", ["usb:0", "rtsp://cam.local/1", "gstreamer:videotestsrc"])
def test_camera_that_films_cannot_be_slowed_down(name: str) -> None:
    with pytest.raises(InputError, match=r"pace: found 0\.1, expected 1"):
        make_source(name, "cam1", WallClock(), None, 0.1)


def test_password_of_a_network_camera_is_not_shown() -> None:
    source = make_source("rtsp://me:secret@127.0.0.1:1/stream", "cam1", WallClock(), None)
    with pytest.raises(InputError) as message:
        source.open()
    assert "secret" not in str(message.value) and "127.0.0.1:1/stream" in str(message.value)
