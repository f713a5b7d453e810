"""The demo: what it fetches is verified; without a network it runs on a simulated scene."""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from e3pose.calibration import save_rig
from e3pose.demo import job as jobs
from e3pose.demo import run_demo, words
from e3pose.demo.clip import CALIBRATION, TOP, VIDEOS, Clip, Member, extract_members, find_clip
from e3pose.demo.pictures import fullest
from e3pose.detectors import Image
from e3pose.errors import InputError
from e3pose.evaluate.poses_table import write_poses
from e3pose.node.source import open_video
from e3pose.overlay import write_movie
from e3pose.pipeline import SlotRecord
from e3pose.pose import Poses2D, Poses3D
from e3pose.recording import load_recording
from e3pose.simulate import DetectorSettings, SceneSettings
from e3pose.simulate.rigs import ring_rig
from e3pose.skeleton import COCO17
from e3pose.weights import Progress

SMALL = SceneSettings(
    people=2, seconds=1.6, fps=10, cameras=4, detector=DetectorSettings(perfect=True)
)


@pytest.fixture(autouse=True)
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("E3POSE_CACHE", str(tmp_path / "cache"))


def refuse(progress: Progress, index_url: str | None = None) -> None:
    raise InputError("wheel of pose2sim==0.10.49: not found in https://index.example/simple")


def test_offline_runs_on_a_simulated_scene(tmp_path: Path) -> None:
    dest = tmp_path / "demo"
    report = run_demo(dest, offline=True, stand_in=SMALL)
    assert not report.real and report.num_frames == 0
    names = {path.name for path in dest.iterdir()}
    expected = "report.html summary.json poses.csv poses.parquet overlay.png recording"
    assert names == {*expected.split(), "e3pose-demo.txt"}
    assert [path.name for path in tmp_path.iterdir()] == ["demo"]
    summary = json.loads((dest / "summary.json").read_text())
    assert summary["slots"] == 16
    assert summary["selection"]["mean_cameras"] == pytest.approx((10 * 4 + 6 * 2) / 16)
    assert summary["metrics"]["mpjpe_mm"] < 1.0  # exact detections
    assert load_recording(dest / "recording").num_slots == 16
    assert (dest / "poses.csv").read_text().startswith("slot,time,track,joint,x,y,z,score\n")


def test_offline_says_what_it_could_not_fetch_and_where_to_look(tmp_path: Path) -> None:
    dest = tmp_path / "demo"
    said = words(run_demo(dest, offline=True, stand_in=SMALL))
    assert said[0].startswith("Could not fetch the four-camera recording: not fetched before")
    assert said[1].startswith("Could not fetch the network openpose-thin: not fetched before")
    assert said[2] == "So this ran on a simulated scene with 4 cameras instead."
    text = "\n".join(said)
    assert "chose 2 cameras to stay awake (all in the first 10)" in text
    assert "3.2 of 4 cameras were awake" in text and "% less energy" in text
    assert str(dest / "report.html") in text and "overlay.webm" not in text
    assert "So this ran on a simulated scene" in (dest / "e3pose-demo.txt").read_text()


def test_failed_download_is_told_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jobs, "fetch_clip", refuse)
    monkeypatch.setattr(jobs, "pull_weights", lambda name, progress: refuse(progress))
    phases: list[str] = []

    @contextmanager
    def phase(name: str) -> Iterator[Progress]:
        phases.append(name)
        yield lambda done, total: None

    said = words(run_demo(tmp_path / "demo", stand_in=SMALL, phase=phase))
    assert said[0] == (
        "Could not fetch the four-camera recording: wheel of pose2sim==0.10.49: not found in "
        "https://index.example/simple."
    )
    assert phases == [
        "fetching the four-camera recording",
        "fetching the network openpose-thin",
        "simulating a scene",
        "selecting cameras, triangulating",
        "drawing",
    ]


def test_folder_of_somebody_else_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    for overwrite in (False, True):
        with pytest.raises(InputError, match=tmp_path.name):
            run_demo(tmp_path, offline=True, overwrite=overwrite, stand_in=SMALL)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_second_demo_replaces_the_first_if_asked(tmp_path: Path) -> None:
    dest = tmp_path / "demo"
    run_demo(dest, offline=True, stand_in=SMALL)
    with pytest.raises(InputError, match="--overwrite"):
        run_demo(dest, offline=True, stand_in=SMALL)
    (dest / "report.html").write_text("old")
    run_demo(dest, offline=True, overwrite=True, stand_in=SMALL)
    assert (dest / "report.html").stat().st_size > 1_000_000


def test_failure_on_the_way_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*args: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr("e3pose.evaluate.poses_table.write_poses", broken)
    assert write_poses is not broken
    with pytest.raises(InputError, match="demo: cannot be written: disk full"):
        run_demo(tmp_path / "demo", offline=True, stand_in=SMALL)
    assert list(tmp_path.iterdir()) == []


class Standing:
    """A detector that sees one person in the middle of every image."""

    skeleton = COCO17

    def detect(self, image: Image) -> Poses2D:
        height, width = image.shape[:2]
        middle = np.array([width / 2 - 0.5, height / 2 - 0.5])
        return Poses2D(np.tile(middle, (1, len(COCO17), 1)), np.ones((1, len(COCO17))))


def test_videos_become_poses_a_movie_and_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = ring_rig(4, 4.0, 2.0, (96, 64), np.random.default_rng(0))
    save_rig(rig, tmp_path / "rig.toml")
    videos = tuple(tmp_path / f"{name}.mp4" for name in rig.camera_ids)
    for video in videos:
        write_movie(video, [np.full((64, 96, 3), 90, np.uint8)] * 40, 60)
    clip = Clip(tmp_path / "rig.toml", videos)
    monkeypatch.setattr(jobs, "fetch_clip", lambda progress: clip)
    monkeypatch.setattr(jobs, "pull_weights", lambda name, progress: tmp_path / "none.pb")
    monkeypatch.setattr("e3pose.detectors.make_detector", lambda name, model: Standing())
    report = run_demo(tmp_path / "demo")
    assert report.real and report.num_frames == 4 * 20 and report.not_fetched == ()
    assert words(report)[0].startswith("Took a real recording of 4 cameras and looked for people")
    recording = load_recording(tmp_path / "demo" / "recording")
    assert recording.fps == 30 and set(recording.videos) == set(rig.camera_ids)
    for name in recording.videos.values():
        assert (tmp_path / "demo" / "recording" / "videos" / name).stat().st_size > 0
    movie = open_video(tmp_path / "demo" / "overlay.webm")
    assert len(list(movie.frames(0.0))) == 20 and movie.rate == pytest.approx(10)
    assert not (tmp_path / "demo" / "detected").exists()


def wheel(path: Path, contents: dict[str, bytes]) -> tuple[Member, ...]:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(TOP + name, content)
        archive.writestr("../../evil.txt", b"evil")
    return tuple(Member(n, len(c), hashlib.sha256(c).hexdigest()) for n, c in contents.items())


def test_only_the_members_wanted_are_unpacked(tmp_path: Path) -> None:
    path, dest = tmp_path / "p.whl", tmp_path / "out"
    members = wheel(path, {"videos/a.mp4": b"film", "calibration/c.txt": b"rig", "x.py": b"code"})
    extract_members(path, members[:2], dest)
    assert {p.name: p.read_bytes() for p in dest.iterdir()} == {"a.mp4": b"film", "c.txt": b"rig"}


def altered(member: Member) -> Member:
    return Member(member.name, member.size_bytes, "0" * 64)


def longer(member: Member) -> Member:
    return Member(member.name, member.size_bytes - 1, member.sha256)


def missing(member: Member) -> Member:
    return Member("videos/none.mp4", member.size_bytes, member.sha256)


@pytest.mark.parametrize("change", [altered, longer, missing])
def test_other_member_than_expected_is_refused(
    change: Callable[[Member], Member], tmp_path: Path
) -> None:
    path = tmp_path / "p.whl"
    (member,) = wheel(path, {"videos/a.mp4": b"film" * 100})
    with pytest.raises(InputError, match=r"p\.whl: videos/"):
        extract_members(path, (change(member),), tmp_path / "out")
    assert not (tmp_path / "out" / "a.mp4").exists()


@pytest.mark.parametrize("keep", [0, 30, 200])
def test_truncated_wheel_is_refused(keep: int, tmp_path: Path) -> None:
    path = tmp_path / "p.whl"
    members = wheel(path, {"videos/a.mp4": bytes(range(256)) * 9})
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(InputError, match=r"p\.whl: not a readable wheel"):
        extract_members(path, members, tmp_path / "out")


def test_damaged_cache_does_not_count_as_the_clip(tmp_path: Path) -> None:
    folder = tmp_path / "cache" / "clips" / "pose2sim-0.10.49"
    folder.mkdir(parents=True)
    for member in (CALIBRATION, *VIDEOS):
        (folder / Path(member.name).name).write_bytes(b"0" * member.size_bytes)
    assert find_clip() is None


def test_fullest_slot_of_each_quarter_is_pictured() -> None:
    def record(slot: int, joints: int) -> SlotRecord:
        scores = np.zeros((1, 17))
        scores[0, :joints] = 1
        flags = np.ones(1, dtype=bool)
        poses = Poses3D(np.zeros((1, 17, 3)), scores)
        nothing = np.zeros(1)
        ids = np.zeros(1, dtype=np.int64)
        return SlotRecord(slot, 0.0, flags, flags, poses, ids, nothing, nothing, flags)

    records = [record(i, n) for i, n in enumerate([1, 5, 3, 2, 0, 9, 4, 4])]
    assert fullest(records) == {1, 2, 5, 6}
    assert fullest(records[:2]) == {0, 1}
    assert fullest([]) == set()
