"""`e3pose demo`: what it fetches, runs, replays and leaves; without a network, on a simulation."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from tests.cli.commands import refused, run
from tests.site.left_by_site import status_of
from tests.waiting import commands_below

from e3pose.base.errors import Exit, InputError
from e3pose.camera.source import open_video
from e3pose.cli import demonstrating
from e3pose.detectors.timing import DetectionTimes
from e3pose.detectors.weights import Progress
from e3pose.recording import load_recording, save_recording
from e3pose.settings.resolved import ResolvedSite
from e3pose.settings.site_file import load_site
from e3pose.simulate import DetectorSettings, SceneSettings, simulate
from e3pose.site.demo_clip import TITLE, Clip
from e3pose.site.simulated_films import write_films
from e3pose.site.up import Program
from e3pose.store import Store
from e3pose.wire.site_messages import Status

pytestmark = pytest.mark.slow

SMALL = SceneSettings(
    people=1,
    seconds=1.2,
    fps=10,
    cameras=3,
    image_size=(480, 360),
    detector=DetectorSettings(perfect=True),
)
FILES = {"report.html", "overlay.webm", "poses.parquet", "poses.csv",
         "summary.json", "recording", "site", "e3pose-demo.txt"}  # fmt: skip


@pytest.fixture(autouse=True)
def unreachable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demonstrating, "STAND_IN", SMALL)
    monkeypatch.setenv("E3POSE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("E3POSE_OFFLINE", "1")


def measured(workloads: Sequence[object]) -> DetectionTimes:
    return DetectionTimes(np.full(len(workloads), 0.3), np.full(len(workloads), 0.6))


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[Sequence[Program]]:
    """The programs of sites that a demo would have run; a detection takes 0.3 s here."""
    found = list[Sequence[Program]]()

    def shown(
        site: ResolvedSite, programs: Sequence[Program], *_: object, over: Callable[..., bool]
    ) -> Status:
        found.append(programs)
        status = status_of(site.file.name, 24, list(site.cameras), None)
        early = status_of(site.file.name, 3, ["cam0"], None)
        assert not over(None) and not over(early) and over(status)
        return status

    monkeypatch.setattr(
        demonstrating, "run_shown", lambda *given: shown(*given[:-1], over=given[-1])
    )
    monkeypatch.setattr("e3pose.site.detector_speed.time_detections", measured)
    return found


def test_offline_leaves_the_same_files_of_a_simulated_scene(
    tmp_path: Path,
    ran: list[Sequence[Program]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    dest = tmp_path / "demo"
    assert run("demo", dest) == 0
    out, err = capsys.readouterr()
    assert out.startswith(
        "Could not download the four-camera recording: not in the cache, and this run is offline.\n"
    )
    assert f"{dest / 'report.html'}: open this first" in out
    assert [line for line in err.splitlines() if line.endswith("...")] == [
        "simulating a scene ...",
        "running the edge and the cameras ...",
        "drawing the pictures ...",
    ]
    assert {path.name for path in dest.iterdir()} == FILES
    assert [program.name for program in ran[0]] == ["edge", "cam0", "cam1", "cam2"]
    summary = json.loads((dest / "summary.json").read_text())
    assert summary["slots"] == 12 and summary["live"]["slot"] == 24
    # All three cameras in the ten slots of the warm-up, then two.
    assert summary["selection"]["mean_cameras"] == pytest.approx((10 * 3 + 2 * 2) / 12)
    assert summary["metrics"]["mpjpe_mm"] < 50
    assert summary["live"]["saved"]["processor_time"]["basis"] == "measured"
    page = (dest / "report.html").read_text()
    assert "No pictures" not in page and "<img id='film'" in page
    assert (dest / "poses.csv").read_text().startswith("slot,time,track,joint,x,y,z,score,")
    assert run("replay", dest / "recording") == 0, "what it leaves can be used again"
    assert refused(capsys, "demo", dest).startswith(f"e3pose: {dest}")
    (dest / "report.html").write_text("old")

    def refuse(progress: Progress) -> None:
        raise InputError("wheel of pose2sim==0.10.49: not found in https://index.example/simple")

    monkeypatch.delenv("E3POSE_OFFLINE")
    monkeypatch.setattr(demonstrating, "fetch_clip", refuse)
    assert run("demo", dest, "--overwrite") == 0
    assert (dest / "report.html").stat().st_size > 1_000_000
    out, err = capsys.readouterr()
    assert out.splitlines()[:2] == [
        "Could not download the four-camera recording: wheel of pose2sim==0.10.49: not found in "
        "https://index.example/simple.",
        "This is a simulated scene instead.",
    ]
    assert err.startswith("downloading the four-camera recording ...\nsimulating a scene ...\n")


def test_clip_is_detected_in_played_slower_and_drawn(
    tmp_path: Path,
    ran: list[Sequence[Program]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    films = tmp_path / "films"
    made = simulate(replace(SMALL, fps=20.0), 0)
    save_recording(made, films)
    write_films(made, films, lambda share: None)
    videos = tuple(films / "videos" / f"{name}.mp4" for name in made.rig.camera_ids)
    clip = Clip(films / "calibration.toml", videos)
    monkeypatch.setattr(demonstrating, "find_clip", lambda: clip)
    monkeypatch.setattr(demonstrating, "ready_network", lambda asked, live, offline: "drawn")
    dest = tmp_path / "demo"
    assert run("demo", dest) == 0
    out = capsys.readouterr().out
    assert "Could not" not in out and TITLE in (dest / "report.html").read_text()
    site = load_site(dest / "site")
    # Three cameras of 0.6 s each reach 5 detections per second, and 0.8 of them are to be had.
    assert site.pace == pytest.approx(1.3 / 20, rel=0.02) and f"at {site.pace:g}x speed" in out
    assert site.deadline_ms == pytest.approx(2500 / 20 / site.pace, abs=1)
    for camera in site.camera:
        assert camera.detector == "drawn" and Path(camera.source or "").is_file()
    recording = load_recording(dest / "recording")
    assert sum(len(series.scores) for series in recording.views) >= recording.num_slots
    movie = open_video(dest / "overlay.webm")
    assert len(list(movie.frames(0.0))) == 2 * recording.num_slots == 48  # all cameras, then two
    assert movie.rate == pytest.approx(20 / 3, rel=1e-3)


def test_program_that_ends_by_itself_ends_the_demo_with_its_last_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def shown(site: object, programs: Sequence[Program], logs: Path, *rest: Any) -> None:
        logs.mkdir()
        programs[1].log.write_text("starting\nthe lens fell off\n")
        programs[1].restarts = 1
        rest[-1](None)

    monkeypatch.setattr(demonstrating, "run_shown", shown)
    monkeypatch.setattr("e3pose.site.detector_speed.time_detections", measured)
    assert run("demo", tmp_path / "demo") == 2
    assert capsys.readouterr().err.endswith("e3pose: cam0: the lens fell off\n")
    monkeypatch.setattr(demonstrating, "run_shown", lambda *_: signal.raise_signal(signal.SIGTERM))
    assert run("demo", tmp_path / "demo") == Exit.SIGNAL + signal.SIGTERM
    assert [path.name for path in tmp_path.iterdir()] == [], "nothing is left"


def test_taken_destination_is_one_line_and_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    for words in ([], ["--overwrite"]):
        assert refused(capsys, "demo", tmp_path, *words).startswith(f"e3pose: {tmp_path}:")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.nightly  # tests/live runs `up`, and the tests above all but the programs
def test_demo_runs_a_site_of_real_processes(tmp_path: Path) -> None:
    dest = tmp_path / "demo"
    before = set(psutil.Process().children(recursive=True))
    assert run("demo", dest) == 0
    summary = json.loads((dest / "summary.json").read_text())
    assert summary["slots"] == 12 and summary["live"]["slot"] >= 12
    slots = Store(dest / "site" / "live.db").rows("slots")
    assert len(slots) >= 10
    for log in (dest / "site" / "logs").iterdir():
        assert "Traceback" not in log.read_text()
    after = commands_below(psutil.Process())
    assert not [c for p, c in after.items() if p not in before and "e3pose" in " ".join(c)]
