"""The demo: what it fetches is verified; it runs a live site, without a network on a simulation."""

from __future__ import annotations

import hashlib
import json
import signal
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from tests.site.left_by_demo import BEGIN_NS, canned, nobody
from tests.waiting import eventually

from e3pose.base.errors import InputError
from e3pose.camera.source import open_video
from e3pose.detectors.weights import Progress
from e3pose.evaluate.poses_table import write_poses
from e3pose.model.people import People
from e3pose.model.rigs import ring_rig
from e3pose.model.skeleton import skeleton_by_name
from e3pose.output.report.overlay import write_movie
from e3pose.pipeline import SlotRecord
from e3pose.recording import load_recording
from e3pose.recording.calibration import save_rig
from e3pose.settings.site_file import load_site
from e3pose.simulate import DetectorSettings, SceneSettings
from e3pose.site.demo import job as jobs
from e3pose.site.demo import printed_lines, run_demo
from e3pose.site.demo.clip import CALIBRATION, TOP, VIDEOS, Clip, Member, extract_members, find_clip
from e3pose.site.demo.live import Heard, Show
from e3pose.site.demo.pictures import fullest
from e3pose.site.demo.stored_run import Film, stored_records
from e3pose.site.demo.summary import LiveFigures, processor_words
from e3pose.store import Run, StoreWriter

pytestmark = pytest.mark.slow

SMALL = SceneSettings(
    people=2, seconds=2.0, fps=10, cameras=4, detector=DetectorSettings(perfect=True)
)


@pytest.fixture(autouse=True)
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("E3POSE_CACHE", str(tmp_path / "cache"))


def refuse(progress: Progress, index_url: str | None = None) -> None:
    raise InputError("wheel of pose2sim==0.10.49: not found in https://index.example/simple")


@pytest.fixture
def without_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("e3pose.site.demo.live.run_live", canned)


def test_offline_runs_live_on_a_simulated_scene(tmp_path: Path) -> None:
    dest = tmp_path / "demo"
    # Another site on this machine is none of the demo's business.
    other = subprocess.Popen(
        [sys.executable, "-c", "import sys; sys.stdin.read()", "e3pose"], stdin=subprocess.PIPE
    )
    before = set(psutil.Process().children(recursive=True))
    shown: list[tuple[int, int]] = []

    @contextmanager
    def watch() -> Iterator[Show]:
        yield lambda status, done, total: shown.append((done, total))

    report = run_demo(dest, offline=True, stand_in=SMALL, watch=watch)
    live = report.live
    assert not report.real and live.pace == 1
    assert live.view_bytes > 40 * live.views and live.orders > 0
    assert shown and {total for _, total in shown} == {20}
    records, times, _ = stored_records(dest / "site" / "live.db", 0.1, Film(2.0, 1.0), 20)
    assert set(np.diff(times)) == {100_000_000}
    # All cameras look at first, and then two.
    assert [int(r.selected.sum()) for r in records[:8]] == [4] * 8
    # It ends with the scene, or goes on where cameras came too late to see half of it.
    summary = json.loads((dest / "summary.json").read_text())
    assert 10 <= summary["slots"] <= 20
    # Exact detections; the filter smooths, and on a busy machine the scene begins again.
    assert summary["metrics"]["mpjpe_mm"] < 50
    for log in (dest / "site" / "logs").iterdir():
        assert "Traceback" not in log.read_text()
    children = set(psutil.Process().children(recursive=True)) - before
    alive = [c for c in children if c.is_running() and c.status() != psutil.STATUS_ZOMBIE]
    assert not [c for c in alive if "e3pose" in " ".join(c.cmdline())]
    other.communicate()


@pytest.mark.parametrize(("late", "slots"), [(0, 20), (8, 12), (10, 10), (11, 20), (15, 20)])
def test_run_ends_with_the_film_where_its_first_round_gave_half_of_the_slots(
    late: int, slots: int
) -> None:
    """Cameras that come `late` slots after the film began see it again, and all slots are run."""
    slot_ns = 100_000_000
    heard = Heard(begin_ns=BEGIN_NS, end_ns=BEGIN_NS + 20 * slot_ns - slot_ns // 2)
    rows = []
    for slot in range(20):
        time_ns = BEGIN_NS + (late + slot) * slot_ns + slot_ns // 4
        heard.poses(SimpleNamespace(slot=slot, time_edge_ns=time_ns, published_edge_ns=time_ns))  # type: ignore[arg-type]
        rows.append(time_ns)
        if heard.enough(20, slot_ns):
            break
    assert len(rows) == slots
    # What is stored of that run is its first round, or all of it.
    assert (sum(time_ns < heard.end_ns for time_ns in rows) >= 10) == (late <= 10)


def test_interrupt_leaves_no_process_and_no_file(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "e3pose", "demo", "demo", "--offline"]
    demo = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    watched = psutil.Process(demo.pid)

    def started() -> bool:
        """Return whether an edge and four cameras run, which end with the demo if it is killed."""
        commands = [child.cmdline() for child in watched.children()]
        return sum("--end-with-parent" in command for command in commands) == 5

    try:
        assert eventually(lambda: demo.poll() is not None or started(), 120.0)
        children = watched.children(recursive=True)
        demo.send_signal(signal.SIGINT)
        _, output = demo.communicate(timeout=60)
    finally:
        demo.kill()
    assert demo.returncode == 130 and output.decode().strip().endswith("e3pose: interrupted")
    _, alive = psutil.wait_procs(children, timeout=0)
    assert not [child for child in alive if child.status() != psutil.STATUS_ZOMBIE]
    assert [path.name for path in tmp_path.iterdir() if path.name != "cache"] == []


@pytest.mark.usefixtures("without_processes")
def test_what_the_run_left_is_laid_out(tmp_path: Path) -> None:
    dest = tmp_path / "demo"
    report = run_demo(dest, offline=True, stand_in=SMALL)
    names = {path.name for path in dest.iterdir()}
    expected = "report.html summary.json poses.csv poses.parquet overlay.png site"
    assert names == {*expected.split(), "e3pose-demo.txt"}
    summary = json.loads((dest / "summary.json").read_text())
    assert summary["slots"] == 20
    assert summary["selection"]["mean_cameras"] == pytest.approx((10 * 4 + 10 * 2) / 20)
    assert summary["live"]["orders"] == 80 and summary["live"]["late_orders"] == 4
    assert summary["metrics"]["mpjpe_mm"] < 5.0
    assert report.live.video_bytes == 0
    assert load_recording(dest / "site" / "recording").num_slots == 20
    assert load_site(dest / "site" / "site.toml").name == "demo"
    assert (dest / "poses.csv").read_text().startswith("slot,time,track,joint,x,y,z,score,")
    assert "76 of 80 orders" in (dest / "report.html").read_text()


@pytest.mark.usefixtures("without_processes")
def test_offline_says_what_it_could_not_fetch_and_where_to_look(tmp_path: Path) -> None:
    dest = tmp_path / "demo"
    said = printed_lines(run_demo(dest, offline=True, stand_in=SMALL))
    assert said[0].startswith("Could not download the four-camera recording: not in the cache")
    assert said[1].startswith("Could not download the network openpose-thin: not in the cache")
    assert said[2].startswith("Ran a live site on a simulated scene instead: an edge server and 4")
    text = "\n".join(said)
    assert "20 slots the edge selected cameras 2 slots ahead" in text
    assert "all cameras in the first 10 slots, then 2.0 per slot on average (goal: 2)." in text
    assert "On average 3.0 of 4 cameras were active. Saved, compared with all cameras" in text
    assert "Timing: 76 of 80 orders and 60 of 60 views arrived in time; 0 slots lost." in text
    assert "Network: 2 kB of keypoints" in text and "speed" not in text
    assert str(dest / "report.html") in text and "overlay.webm" not in text
    assert "Ran a live site on a simulated scene" in (dest / "e3pose-demo.txt").read_text()


@pytest.mark.usefixtures("without_processes")
def test_failed_download_is_reported_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jobs, "fetch_clip", refuse)
    monkeypatch.setattr(jobs, "pull_weights", lambda name, progress: refuse(progress))
    phases: list[str] = []

    @contextmanager
    def phase(name: str) -> Iterator[Progress]:
        phases.append(name)
        yield lambda done, total: None

    said = printed_lines(run_demo(tmp_path / "demo", stand_in=SMALL, phase=phase))
    assert said[0] == (
        "Could not download the four-camera recording: wheel of pose2sim==0.10.49: not found in "
        "https://index.example/simple."
    )
    assert phases == [
        "downloading the four-camera recording",
        "downloading the network openpose-thin",
        "simulating a scene",
        "writing the results",
    ]


def test_folder_of_somebody_else_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    for overwrite in (False, True):
        with pytest.raises(InputError, match=tmp_path.name):
            run_demo(tmp_path, offline=True, overwrite=overwrite, stand_in=SMALL)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


@pytest.mark.usefixtures("without_processes")
def test_second_demo_replaces_the_first_if_asked(tmp_path: Path) -> None:
    dest = tmp_path / "demo"
    run_demo(dest, offline=True, stand_in=SMALL)
    with pytest.raises(InputError, match="--overwrite"):
        run_demo(dest, offline=True, stand_in=SMALL)
    (dest / "report.html").write_text("old")
    run_demo(dest, offline=True, overwrite=True, stand_in=SMALL)
    assert (dest / "report.html").stat().st_size > 1_000_000


@pytest.mark.usefixtures("without_processes")
def test_failure_on_the_way_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*args: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr("e3pose.site.demo.job.write_poses", broken)
    assert write_poses is not broken
    with pytest.raises(InputError, match="demo: cannot be written: disk full"):
        run_demo(tmp_path / "demo", offline=True, stand_in=SMALL)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("without_processes")
def test_videos_become_a_slower_site_poses_and_a_movie(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = ring_rig(4, 4.0, 2.0, (96, 64), np.random.default_rng(0))
    save_rig(rig, tmp_path / "rig.toml")
    videos = tuple(tmp_path / f"{name}.mp4" for name in rig.camera_ids)
    for video in videos:
        write_movie(video, [np.full((64, 96, 3), 90, np.uint8)] * 60, 60)
    clip = Clip(tmp_path / "rig.toml", videos)
    monkeypatch.setattr(jobs, "fetch_clip", lambda progress: clip)
    monkeypatch.setattr(jobs, "pull_weights", lambda name, progress: tmp_path / "none.pb")
    monkeypatch.setattr(jobs, "_alone_s", lambda video, weights: 0.3)
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 1})
    report = run_demo(tmp_path / "demo")
    assert report.real and report.not_fetched == ()
    said = printed_lines(report)
    assert said[0].startswith(
        "Ran a live site: an edge server and 4 camera processes that play real"
    )
    assert said[1] == (
        "Videos played at 0.046x speed: one detection takes 300 ms on this machine, and 4 cameras "
        "share 2 cores."
    )
    site = load_site(tmp_path / "demo" / "site" / "site.toml")
    assert site.pace == 0.046 and site.fps == 20 and site.skeleton_name == "coco18"
    # An order must be able to come although every slot waits for its deadline.
    assert site.deadline_ms == pytest.approx(2500 / 20 / 0.046, abs=1)
    for camera in site.camera:
        assert (
            camera.source == str(site.folder / f"videos/{camera.id}.mp4")
            and camera.detector == "openpose-thin"
        )
        assert Path(camera.source).stat().st_size > 0
    movie = open_video(tmp_path / "demo" / "overlay.webm")
    assert len(list(movie.frames(0.0))) == 20  # the three slots after the clip's end are left out
    assert movie.rate == pytest.approx(20 / 3, rel=1e-3)
    assert report.live.video_bytes == sum(video.stat().st_size for video in videos)


@pytest.mark.parametrize(
    ("alone_s", "cores", "expected"),
    [(0.3, 2, 0.046), (0.085, 2, 0.16), (0.085, 16, 1.0), (0.006, 1, 1.0), (100.0, 1, 0.01)],
)
def test_pace_lets_all_cameras_look_in_every_slot(
    alone_s: float, cores: int, expected: float
) -> None:
    pace = jobs.pace_for(alone_s, 4, 20.0, cores)
    assert pace == pytest.approx(expected)
    assert pace <= 0.01 or 4 * 20.0 * pace * alone_s <= cores


@pytest.mark.parametrize(("before_seam", "expected"), [(18, 18), (10, 10), (6, 20)])
def test_slots_after_the_clip_began_again_are_left_out_unless_needed(
    tmp_path: Path, before_seam: int, expected: int
) -> None:
    skeleton = skeleton_by_name("coco18")
    run = Run("demo", "demo", BEGIN_NS, 0.1, skeleton.name, skeleton.joints, ("a", "b"))
    first_ns = BEGIN_NS + (20 - before_seam) * 1_000_000_000  # cameras came late
    with StoreWriter(tmp_path / "live.db", run) as writer:
        for slot in range(25):
            writer.append(nobody(slot, 0.1, 2), time_ns=first_ns + slot * 1_000_000_000)
    film = Film(length_s=2.0, pace=0.1, begin_ns=BEGIN_NS)
    records, _, _ = stored_records(tmp_path / "live.db", 0.1, film, 20)
    assert [record.slot for record in records] == list(range(expected))


def test_film_says_which_moment_was_shown() -> None:
    film = Film(length_s=2.0, pace=0.1, begin_ns=BEGIN_NS)
    assert film.at_s(BEGIN_NS) == 0
    assert film.at_s(BEGIN_NS + 5_000_000_000) == pytest.approx(0.5)
    assert film.at_s(BEGIN_NS + 21_000_000_000) == pytest.approx(0.1)


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
        people, nothing = People(np.array([0]), np.zeros((1, 17, 3)), scores), np.zeros(1)
        return SlotRecord(slot, 0.0, flags, flags, people, nothing, nothing, flags)

    records = [record(i, n) for i, n in enumerate([1, 5, 3, 2, 0, 9, 4, 4])]
    assert fullest(records) == {1, 2, 5, 6}
    assert fullest(records[:2]) == {0, 1}
    assert fullest([]) == set()


def test_processor_time_is_told_where_it_was_measured() -> None:
    live = LiveFigures(
        1.0, 0.0, 2, 1, 0, 0, 0, 0, 0, 0, 0, 0, (0.0, 0.0), 0.0, {}, 2.0,
        look_cpu_ms=168.0, frame_cpu_ms=15.0,
    )  # fmt: skip
    (line,) = processor_words(live)
    assert "a look took 168 ms and a frame 15.0 ms" in line
    assert processor_words(replace(live, look_cpu_ms=0.0)) == []
