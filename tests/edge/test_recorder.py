"""Views that arrive at an edge become recordings of bounded length and size."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from tests.rigs import looking
from tests.waiting import eventually

from e3pose.base.errors import InputError
from e3pose.camera.provenance import load_provenance
from e3pose.camera.session_videos import attach_videos
from e3pose.edge.gather import Arrival
from e3pose.edge.recorder import Recorder, RecorderSettings, recordings_in
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import ProcessorTime, load_recording, save_recording
from e3pose.recording.videos import video_name
from e3pose.recording.writer import PARTIAL, ROOM
from e3pose.wire.messages import Heartbeat

RIG = looking((4, 0), (0, 4), (-4, 0))
BEGIN_NS = 1_800_000_000 * 10**9
FPS = 20.0
POSES = Poses2D(np.full((1, 17, 2), 5.0), np.full((1, 17), 0.5))


def settings(folder: Path) -> RecorderSettings:
    return RecorderSettings(folder, "lab", (True, True, False), FPS, 1.0, COCO17, "openpose")


def record(asked: RecorderSettings, slots: Sequence[int]) -> list[str]:
    """Let three cameras see a person in some slots; return the messages."""
    messages: list[str] = []
    recorder = Recorder(asked, RIG, lambda kind, line: messages.append(f"{kind}: {line}"))
    for slot in slots:
        time_ns = BEGIN_NS + round(slot * 1e9 / FPS)
        recorder.keep(slot, time_ns, {i: Arrival(POSES, time_ns + 10**6, 0) for i in range(3)})
    recorder.close()
    return messages


def test_views_of_the_cameras_asked_for_are_a_recording(tmp_path: Path) -> None:
    assert record(settings(tmp_path / "recordings"), [100, 101, 103]) == []
    (part,) = recordings_in(tmp_path / "recordings")
    assert part.name == "20270115T080005Z"
    recording = load_recording(part)
    assert recording.num_slots == 4 and recording.detector == "openpose"
    assert [series.slots.tolist() for series in recording.views] == [[0, 1, 3], [0, 1, 3], []]
    assert recording.views[0].times_s == pytest.approx([0.001, 0.051, 0.151])
    assert "site lab from 2027-01-15 08:00:05 UTC" in recording.source


def test_parts_have_the_processor_time_of_their_cameras(tmp_path: Path) -> None:
    recorder = Recorder(settings(tmp_path / "recordings"), RIG, lambda kind, line: None)
    for second in range(3):
        beat = Heartbeat(
            "c0", 1, 0, "active", detected=10 * second, active_s=second, cpu_s=1.5 * second,
            look_cpu_s=second,
        )  # fmt: skip
        recorder.processor.take(beat)
        recorder.keep(second, BEGIN_NS + second * 10**9, {0: Arrival(POSES, BEGIN_NS, 0)})
    recorder.close()
    (part,) = recordings_in(tmp_path / "recordings")
    found = load_recording(part).processor
    assert found == {"c0": ProcessorTime(0.1, 0.5 / FPS, 20)}


def test_oldest_parts_make_room(tmp_path: Path) -> None:
    record(replace(settings(tmp_path), part_s=1.0), range(20))
    size = sum(file.stat().st_size for file in tmp_path.rglob("*") if file.is_file())
    asked = replace(settings(tmp_path), part_s=1.0, max_bytes=round(2.5 * size))
    messages: list[str] = []
    recorder = Recorder(asked, RIG, lambda kind, line: messages.append(line))
    for slot in range(100, 200):
        time_ns = BEGIN_NS + round(slot * 1e9 / FPS)
        recorder.keep(slot, time_ns, {0: Arrival(POSES, time_ns, 0), 1: Arrival(POSES, time_ns, 0)})
        if slot % 20 == 19:
            assert eventually(lambda: not recorder.waiting)
    recorder.close()
    parts = [part.name for part in recordings_in(tmp_path)]
    assert 1 <= len(parts) <= 3 and "20270115T080000Z" not in parts and messages == []
    assert sum(f.stat().st_size for f in tmp_path.rglob("*") if f.is_file()) <= 3 * size


def test_what_a_kill_cut_off_is_finished_by_the_next_run(tmp_path: Path) -> None:
    record(settings(tmp_path), range(5))
    (part,) = recordings_in(tmp_path)
    part.rename(part.with_name(part.name + PARTIAL))
    assert recordings_in(tmp_path) == []
    record(settings(tmp_path), [])
    assert load_recording(part).num_slots == 5


def fill(path: Path) -> None:
    with path.open("wb", buffering=0) as file:
        for size in (2**16, 4096, 1):
            with suppress(OSError):
                while True:
                    file.write(b"x" * size)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A megabyte of a file system of its own, where that may be made."""
    place = tmp_path / "small"
    place.mkdir()
    made = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(place)]
    if shutil.which("mount") is None or subprocess.run(made, capture_output=True).returncode:
        pytest.skip("file systems may not be mounted here")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def test_full_disk_costs_no_slot_that_the_queue_holds(
    small_disk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("e3pose.edge.recorder.RETRY_S", 1.0)
    messages: list[str] = []
    folder = small_disk / "recordings"
    recorder = Recorder(
        settings(folder), RIG, lambda kind, line: messages.append(f"{kind}: {line}")
    )

    def keep(first: int, end: int) -> None:
        for slot in range(first, end):
            time_ns = BEGIN_NS + round(slot * 1e9 / FPS)
            recorder.keep(slot, time_ns, {0: Arrival(POSES, time_ns, 0)})

    def kept() -> set[int]:
        found: set[int] = set()
        for part in recordings_in(folder):
            began = datetime.strptime(part.name[:15] + "+0000", "%Y%m%dT%H%M%S%z").timestamp()
            series = load_recording(part).views[0]
            found |= set(np.round((series.times_s + began - BEGIN_NS / 1e9) * FPS).astype(int))
        return found

    keep(0, 20)
    assert eventually(lambda: recorder.waiting == 0)
    fill(small_disk / "ballast")
    keep(20, 600)
    assert eventually(lambda: messages)
    assert eventually(lambda: len(recordings_in(folder)) == 1), "finished on the full disk"
    assert kept() >= set(range(20))
    keep(600, 700)
    (small_disk / "ballast").unlink()
    assert eventually(lambda: len(messages) == 2)
    recorder.close()
    assert [line.partition(":")[0] for line in messages] == ["record-trouble", "record-recovered"]
    assert "no space left" in messages[0] and messages[1].endswith("recording again")
    assert list(folder.glob(f"*{PARTIAL}")) == [] and list(folder.rglob(ROOM)) == []
    assert len(recordings_in(folder)) >= 2
    assert kept() == set(range(700))


def test_slots_beyond_the_queue_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("e3pose.edge.recorder.RETRY_S", 1.0)
    monkeypatch.setattr("e3pose.edge.recorder.QUEUE_SLOTS", 50)
    folder, messages = tmp_path / "recordings", list[str]()
    recorder = Recorder(
        settings(folder), RIG, lambda kind, line: messages.append(f"{kind}: {line}")
    )
    folder.rmdir()
    folder.write_text("in the way")
    recorder.keep(0, BEGIN_NS, {0: Arrival(POSES, BEGIN_NS, 0)})
    assert eventually(lambda: messages)
    for slot in range(1, 70):
        recorder.keep(slot, BEGIN_NS, {0: Arrival(POSES, BEGIN_NS, 0)})
    folder.unlink()
    folder.mkdir()
    assert eventually(lambda: len(messages) == 2)
    recorder.close()
    assert [line.partition(":")[0] for line in messages] == ["record-trouble", "record-recovered"]
    assert messages[1].endswith("recording again, 20 slots not recorded")
    (part,) = recordings_in(folder)
    assert len(load_recording(part).views[0].slots) == 50


def make_videos(folder: Path, camera_id: str, begins: Sequence[int], end_slot: int) -> None:
    """Leave videos that begin in some slots, each written to until the next one began."""
    (folder / camera_id).mkdir(parents=True)
    for begin, end in zip(begins, [*begins[1:], end_slot], strict=True):
        path = folder / camera_id / video_name(camera_id, BEGIN_NS + round(begin * 1e9 / FPS))
        path.write_bytes(b"video")
        end_ns = BEGIN_NS + round(end * 1e9 / FPS)
        os.utime(path, ns=(end_ns, end_ns))


def test_videos_become_part_of_the_recordings_of_their_time(tmp_path: Path) -> None:
    """Also where a camera began before the edge, started again meanwhile, or has no video."""
    videos = tmp_path / "videos"
    make_videos(videos, "c0", [95, 120, 140], 160)
    make_videos(videos, "c1", [100, 121, 124, 138], 139)
    asked = replace(settings(tmp_path), part_s=1.0, filmed=("c0", "c1", "c2"), rotations={"c1": 90})
    assert record(asked, range(100, 140)) == []
    parts = recordings_in(tmp_path)
    recordings = [load_recording(part) for part in parts]
    assert [recording.num_slots for recording in recordings] == [20, 20]
    assert [set(recording.videos) for recording in recordings] == [{"c0", "c1"}] * 2
    starts_s = [load_provenance(part).video_starts_s for part in parts]
    assert starts_s[0] == pytest.approx({"c0": 5 / FPS, "c1": 0.0})
    assert starts_s[1] == pytest.approx({"c0": 0.0, "c1": -4 / FPS})
    assert [load_provenance(part).rotations for part in parts] == [{"c1": 90}] * 2
    assert (parts[0] / "videos" / "c0.mkv").read_bytes() == b"video"
    left = sorted(path.name[-13:-5] for path in videos.rglob("*.mkv"))
    assert len(left) == 3, "those of no recording, and the shorter ones, stay"


def test_videos_of_other_machines_are_put_in_later(tmp_path: Path) -> None:
    record(settings(tmp_path / "recordings"), range(100, 120))
    (part,) = recordings_in(tmp_path / "recordings")
    make_videos(tmp_path / "copied", "c2", [98], 125)
    cameras = RIG.camera_ids
    assert attach_videos(part, tmp_path / "copied", cameras) == ["c2"]
    assert attach_videos(part, tmp_path / "copied", cameras) == []
    assert load_recording(part).videos == {"c2": "c2.mkv"}
    save_recording(load_recording(part), tmp_path / "other")
    with pytest.raises(InputError, match="does not say when it began"):
        attach_videos(tmp_path / "other", tmp_path / "copied", cameras)


def test_recordings_and_videos_share_their_space(tmp_path: Path) -> None:
    make_videos(tmp_path / "videos", "c0", [0], 10)
    (path,) = (tmp_path / "videos" / "c0").iterdir()
    path.write_bytes(bytes(200_000))
    asked = replace(settings(tmp_path), part_s=1.0)
    record(asked, range(100, 120))
    record(replace(asked, max_bytes=210_000), range(120, 140))
    assert [part.name for part in recordings_in(tmp_path)] == ["20270115T080006Z"]
