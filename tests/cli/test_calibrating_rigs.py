"""`e3pose calibrate extrinsics`, `align`, `check` and `e3pose sync` as a user runs them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.calibrate.people_scenes import distances, knocked, walk, without_calibration
from tests.cli.commands import run

from e3pose.calibrate.align import Move
from e3pose.calibrate.recordings import first_seconds
from e3pose.calibrate.synchronise import with_offsets
from e3pose.camera.provenance import load_provenance, save_provenance
from e3pose.recording import load_recording, save_recording
from e3pose.recording.calibration import load_rig, save_rig
from e3pose.recording.record import Recording
from e3pose.site.example import write_recorded

pytestmark = pytest.mark.slow

Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@pytest.fixture(scope="module")
def recording() -> Recording:
    return walk(761, seconds=12.0)


@pytest.fixture(scope="module")
def folders(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    top = tmp_path_factory.mktemp("rigs")
    save_recording(recording, top / "known")
    seldom = walk(761, seconds=12.0, fps=5.0)  # half the views, half the time
    save_recording(without_calibration(seldom), top / "bare")
    save_rig(Move(1.0, Y_UP, np.zeros(3)).rig(recording.rig), top / "yup.toml")
    return top


def test_people_calibrate_a_bare_recording(
    folders: Path, recording: Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    bare, dest = folders / "bare", folders / "rig.toml"
    assert run("replay", bare) == 2
    assert "it is not known where the cameras stand" in capsys.readouterr().err
    assert run("info", bare) == 0
    assert "e3pose calibrate extrinsics" in capsys.readouterr().out
    words = ("--json", "-", "--update", "--height", "171cm")
    assert run("calibrate", "extrinsics", bare, dest, *words) == 0
    output = json.loads(capsys.readouterr().out)
    assert output["source"] == "people" and len(output["cameras"]) == 4
    degrees, _, _ = distances(load_rig(dest), recording.rig)
    assert degrees < 1.0  # twelve seconds
    assert load_recording(bare).rig.placed
    assert not load_recording(bare).rig.cameras[0].lens_assumed
    assert run("calibrate", "check", bare, "--picture", folders / "error.png") == 0
    printed = capsys.readouterr().out
    assert "expected error of a joint" in printed and "cam3" in printed
    assert (folders / "error.png").read_bytes().startswith(b"\x89PNG")


def test_points_calibrate_with_one_distance(
    folders: Path, recording: Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(1)
    ball = rng.uniform([-1.5, -1.5, 0.2], [1.5, 1.5, 2.0], (150, 3))
    pixels = recording.rig.project(ball)
    lines = ["time,camera,u,v"]
    for index, camera in enumerate(recording.rig.cameras):
        for time in np.flatnonzero(camera.sees(ball)).tolist():
            u, v = pixels[index, time] + rng.normal(0, 0.5, 2)
            lines.append(f"{time},{camera.camera_id},{u},{v}")
    (folders / "ball.csv").write_text("\n".join(lines))
    save_rig(recording.rig, folders / "lenses.toml")
    words = ("calibrate", "extrinsics", folders / "ball.csv", folders / "ball.toml")
    lenses = ("--intrinsics", folders / "lenses.toml")
    assert run(*words, *lenses) == 2
    assert "expected --distance" in capsys.readouterr().err
    metres = np.linalg.norm(recording.rig.centers_m[0] - recording.rig.centers_m[1])
    assert run(*words, *lenses, "--distance", f"cam0,cam1={metres}m") == 0
    degrees, millimetres, _ = distances(load_rig(folders / "ball.toml"), recording.rig, False)
    assert degrees < 0.1 and millimetres < 10
    (folders / "ball.csv").write_text("time,camera,u,v\n0,cam0,a,1")
    assert run(*words, *lenses, "--distance", "cam0,cam1=3m") == 2
    assert "ball.csv:2: could not convert" in capsys.readouterr().err


def test_other_axes_are_reported_and_mended(
    folders: Path, recording: Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    yup, fixed = folders / "yup.toml", folders / "fixed.toml"
    assert run("calibrate", "check", folders / "known", "--calibration", yup, "--seconds", "3") == 0
    output = capsys.readouterr().err
    assert f"e3pose calibrate align {yup} fixed.toml --up=y" in output
    assert run("calibrate", "align", yup, fixed, "--up=y") == 0
    assert np.allclose(load_rig(fixed).centers_m, recording.rig.centers_m, atol=1e-6)
    assert run("calibrate", "align", yup, fixed) == 2
    assert "expected --up, --floor or --points" in capsys.readouterr().err


def test_people_tell_the_floor_and_options_the_axes(folders: Path, recording: Recording) -> None:
    tilt = np.array([[1.0, 0, 0], [0, 0.98480775, -0.17364818], [0, 0.17364818, 0.98480775]])
    tilted = folders / "tilted"
    save_recording(recording, tilted)
    save_rig(Move(1.0, tilt, np.array([1.0, 2.0, 0.7])).rig(recording.rig), tilted / RIG)
    words = ("--origin", "cam0", "--x-axis", "cam2")
    assert run("calibrate", "align", tilted, folders / "room.toml", *words) == 0
    room = load_rig(folders / "room.toml")
    for camera, truth in zip(room.cameras, recording.rig.cameras, strict=True):
        assert camera.center_m[2] == pytest.approx(truth.center_m[2], abs=0.06)
    assert room.cameras[0].center_m[:2] == pytest.approx([0, 0], abs=1e-6)
    assert room.cameras[2].center_m[1] == pytest.approx(0, abs=1e-6)


RIG = "calibration.toml"


def test_sync_of_films_in_step_says_so(folders: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("sync", folders / "known", folders / "again", "--max-shift", "1") == 0
    printed = capsys.readouterr().out
    assert "--offset cam0=0.0000" in printed and "again: each view in the slot" in printed
    assert load_recording(folders / "again").num_slots == 120


def test_sync_says_by_how_much_a_live_camera_is_late(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    late_s = np.zeros(len(recording.rig))
    late_s[1] = 0.16  # of slots of 0.1 s
    save_recording(with_offsets(recording, late_s), tmp_path / "late")
    assert run("sync", tmp_path / "late", "--max-shift", "1", "--json", "-") == 0
    delays_ms = json.loads(capsys.readouterr().out)["delays_ms"]
    assert delays_ms.pop("cam1") == pytest.approx(160, abs=25)  # a quarter of a slot
    assert all(0 <= delay_ms < 25 for delay_ms in delays_ms.values())
    assert run("sync", tmp_path / "late", "--max-shift", "1") == 0
    assert "add to the delay_ms of the cameras: cam0" in capsys.readouterr().out


def test_sync_keeps_where_the_videos_begin(recording: Recording, tmp_path: Path) -> None:
    late_s = np.zeros(len(recording.rig))
    late_s[1] = 0.3
    videos = {name: f"/films/{name}.mp4" for name in recording.rig.camera_ids}
    late = replace(with_offsets(recording, late_s), videos=videos)
    save_recording(late, tmp_path / "late")
    save_provenance(tmp_path / "late", {}, dict.fromkeys(videos, 1.0), {"cam1": 90}, True)
    assert run("sync", tmp_path / "late", tmp_path / "in-step", "--max-shift", "1") == 0
    noted = load_provenance(tmp_path / "in-step")
    assert (noted.rotations, noted.as_stored) == ({"cam1": 90}, True)
    assert noted.video_starts_s.pop("cam1") == pytest.approx(1.0, abs=0.05)
    for start_s in noted.video_starts_s.values():  # they wait for cam1, which was late
        assert start_s == pytest.approx(0.7, abs=0.05)


def test_sync_says_what_to_record_where_little_is_seen(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_recording(without_calibration(first_seconds(recording, 3.0)), tmp_path / "short")
    assert run("sync", tmp_path / "short", "--max-shift", "1") == 0
    assert "record a person who walks" in capsys.readouterr().err
    save_recording(first_seconds(recording, 3.0), tmp_path / "known")
    assert run("sync", tmp_path / "known", "--max-shift", "1") == 0
    assert "are too little" not in capsys.readouterr().err


def test_one_camera_is_placed_anew_from_what_a_site_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calm = walk(701, people=2, seconds=21.0, fps=5.0)
    turned = knocked(calm, 2, 2.0, 701, 0.0)
    site = write_recorded(tmp_path / "room", calm)
    assert run("calibrate", "extrinsics", site, "--only", "cam2") == 2
    assert 'set record = "keypoints"' in capsys.readouterr().err
    save_recording(turned, tmp_path / "room" / "recordings" / "20260101T000000Z.partial")
    kept = (tmp_path / "room" / "rig.toml").read_bytes()
    assert run("calibrate", "extrinsics", site, "--only", "cam2", "--json", "-") == 0
    output = json.loads(capsys.readouterr().out)
    assert output["turned_deg"] == pytest.approx(2.0, abs=0.3)
    assert (tmp_path / "room" / "rig.before.toml").read_bytes() == kept
    dest = tmp_path / "other.toml"
    recording = tmp_path / "room" / "recording"
    assert run("calibrate", "extrinsics", recording, dest, "--only", "cam0") == 0
    assert "the other cameras as they were" in capsys.readouterr().out
    assert run("calibrate", "extrinsics", recording, dest, "--only", "cam0", "--update") == 2
    assert run("calibrate", "extrinsics", recording, "--only", "cam0") == 2
