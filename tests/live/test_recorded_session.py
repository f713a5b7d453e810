"""A live site records what it sees, and that is a recording like any other, with its videos."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.cli import commands
from tests.live.processes import COMPILE_S, running
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.camera.provenance import load_provenance
from e3pose.camera.source import open_video
from e3pose.detectors.timing import DetectionTimes
from e3pose.edge.recorder import recordings_in
from e3pose.recording import Recording, load_recording
from e3pose.recording.videos import begin_of, videos_in
from e3pose.settings.resolved import resolve_site
from e3pose.site.detector_speed import KEPT, save_times, workloads_of
from e3pose.store import Store

FPS = 10.0
SITE = f"""
format = "e3pose-site"
version = 1
name = "lab"
calibration = "films/calibration.toml"
fps = {FPS}
[link]
endpoint = "tcp/127.0.0.1:PORT"
[store]
path = "live.db"
[record]
part = "5s"
[loop]
policy = "round-robin"
cameras = 3
predictor = "zero-velocity"
"""
CAMERA = """
[[camera]]
id = "{id}"
source = "films/videos/{id}.mp4"
detector = "drawn"
record = "{record}"
"""
RECORD = {"cam0": "both", "cam1": "both", "cam2": "keypoints", "cam3": "video"}


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a site that ran until two parts of its session were recorded."""
    folder = tmp_path_factory.mktemp("session")
    code = commands.run(
        "simulate", folder / "films", "--people", "2", "--seconds", "6", "--fps", f"{FPS:g}",
        "--cameras", "4", "--resolution", "400x300", "--videos",
    )  # fmt: skip
    assert code == 0
    text = SITE.replace("PORT", str(free_port()))
    path = folder / "site.toml"
    path.write_text(text + "".join(CAMERA.format(id=i, record=r) for i, r in RECORD.items()))
    site = resolve_site(path)  # `up` has no need to measure for seconds how quick it is
    times = DetectionTimes(np.full(4, 0.01), np.full(4, 0.01), (4 / 3,) * 4)
    save_times(folder / KEPT, workloads_of(site), times)
    with running(path, folder / "up.log", "--quiet") as (program, _):
        recordings = folder / "recordings"
        assert eventually(
            lambda: program.poll() is not None or finished(recordings) >= 2, COMPILE_S
        )
        assert program.poll() is None
    return folder


@pytest.fixture
def verb(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Return what runs a verb that must succeed, and returns what it printed."""

    def of(*words: object) -> str:
        code = commands.run(*words)
        said = capsys.readouterr()
        assert code == 0, said.err
        return said.out

    return of


def finished(recordings: Path) -> int:
    if not recordings.is_dir():
        return 0
    return sum(
        "videos" in (part / "recording.toml").read_text() for part in recordings_in(recordings)
    )


def whole(session: Path) -> Path:
    """Return a part that began and ended while the site ran."""
    parts = [part for part in recordings_in(session / "recordings") if load_recording(part).videos]
    return max(parts, key=lambda part: load_recording(part).num_slots)


def test_session_is_a_recording_with_its_videos(session: Path, verb: Callable[..., str]) -> None:
    part = whole(session)
    recording = load_recording(part)
    views = [len(series.slots) for series in recording.views]
    assert min(views[:3]) > 0 and views[3] == 0
    assert set(recording.videos) == {"cam0", "cam1"}
    frames = list(open_video(part / "videos" / recording.videos["cam0"]).frames())
    assert len(frames) > 1.2 * views[0]  # also of slots in which it was not selected
    verb("replay", part)
    assert "missing-video" not in verb("info", part)


def test_videos_show_what_was_seen(session: Path, verb: Callable[..., str], tmp_path: Path) -> None:
    """Detected again from the video, people are where they were in the live session."""
    part = whole(session)
    recording = load_recording(part)
    starts_s = load_provenance(part).video_starts_s
    for camera_id in ("cam0", "cam1"):
        series = recording.views[recording.rig.index(camera_id)]
        shown_s = [f.time_s for f in open_video(part / "videos" / f"{camera_id}.mkv").frames()]
        video_s = series.times_s + starts_s[camera_id]
        inside = (video_s > shown_s[0] - 1e-3) & (video_s < shown_s[-1] + 1e-3)
        assert inside.sum() >= 5
        off_s = np.abs(video_s[inside, None] - np.array(shown_s)).min(axis=1)
        assert np.median(off_s) < 1e-3 and off_s.max() < 0.3 / FPS
    again = tmp_path / "again"
    offsets = [f"--offset={name}={-starts_s[name]}" for name in ("cam0", "cam1")]
    videos = [part / "videos" / f"{name}.mkv" for name in ("cam0", "cam1")]
    drawn = ("--calibration", session / "films" / "calibration.toml", "--model", "drawn")
    verb("detect", *videos, again, *drawn, *offsets)
    agree = compared(recording, load_recording(again))
    assert len(agree) >= 5 and np.mean(agree) > 0.9, agree


def compared(live: Recording, again: Recording) -> list[bool]:
    """Return, of each view in which both have as many people, whether they agree."""
    agree = []
    for camera_id in again.rig.camera_ids:
        before = live.views[live.rig.index(camera_id)]
        after = again.views[again.rig.index(camera_id)]
        for slot in np.intersect1d(before.slots, after.slots).tolist():
            one, two = before.view(slot), after.view(slot)
            assert one is not None and two is not None
            if len(one) != len(two) or not len(one):
                continue
            off = np.linalg.norm(one.keypoints_px[:, None] - two.keypoints_px[None], axis=-1)
            off = off[np.isfinite(off).sum(axis=-1) > 8]
            if len(off):
                agree.append(bool(np.nanmedian(off, axis=-1).min() < 1.0))
    return agree


def test_video_alone_stays_beside(session: Path, verb: Callable[..., str], tmp_path: Path) -> None:
    videos = videos_in(session / "recordings" / "videos" / "cam3")
    assert videos and all(begin_of(path) for path in videos)
    drawn = ("--calibration", session / "films" / "calibration.toml", "--model", "drawn")
    assert "cam3" in verb("detect", videos[-1], tmp_path / "third", *drawn)


def test_energy_of_recording_is_distinguished(session: Path) -> None:
    rows = Store(session / "live.db").rows("energy")
    table = {(row["camera_id"], row["source"]) for row in rows}
    assert {("cam0", "recording"), ("cam3", "recording"), ("cam2", "modelled")} <= table
    assert ("cam2", "recording") not in table
