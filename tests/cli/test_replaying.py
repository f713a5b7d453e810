"""`e3pose replay` as a user runs it."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.calibrate.people_scenes import walk
from tests.cases import each_case
from tests.cli.commands import run
from tests.cli.one_person import one_person

from e3pose.base.errors import Exit
from e3pose.calibrate.people_3d import doubt_people
from e3pose.evaluate.figures import NoiseFound
from e3pose.evaluate.tables import noise_lines
from e3pose.model.camera import Camera, Rig
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording, ViewSeries, load_recording, save_recording
from e3pose.recording.calibration import save_rig

NUM_SLOTS = 25
UPRIGHT = np.eye(3)
COLUMNS = ["slot", "time", "track", "joint", "x", "y", "z", "score", "measured", "sigma"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One person seen exactly by four cameras, so that every number is known."""
    path = tmp_path_factory.mktemp("replay") / "recording"
    save_recording(one_person([0.2, 1.7, 3.4, 4.9], NUM_SLOTS), path)
    return path


def test_figures_and_poses_are_written(folder: Path, tmp_path: Path) -> None:
    figures, poses = tmp_path / "figures.json", tmp_path / "poses.csv"
    code = run(
        "replay", str(folder), "--policy", "round-robin", "--cameras", "2", "--pipeline", "paper",
        "--json", str(figures), "--poses", str(poses),
    )  # fmt: skip
    assert code == 0
    summary = json.loads(figures.read_text())
    assert summary["slots"] == NUM_SLOTS
    assert summary["policy"] == "round-robin"
    assert summary["metrics"]["mpjpe_mm"] < 0.1
    assert summary["metrics"]["recall_500mm"] == 1.0
    assert summary["selection"]["mean_cameras"] == pytest.approx((11 * 4 + 14 * 2) / 25)
    assert 0 < summary["savings"]["whole_camera"]["percent"] < 100
    rows = list(csv.DictReader(poses.read_text().splitlines()))
    assert list(rows[0]) == COLUMNS
    assert len(rows) == NUM_SLOTS * 17
    assert {row["joint"] for row in rows} == set(COCO17.joints)
    assert {row["track"] for row in rows} == {"1"}
    nose = [row for row in rows if row["joint"] == "nose"]
    steps = np.diff([float(row["x"]) for row in nose])
    np.testing.assert_allclose(steps, 0.01, atol=1e-4)


def test_parquet_holds_the_same_rows(folder: Path, tmp_path: Path) -> None:
    from pyarrow import parquet

    poses = tmp_path / "poses.parquet"
    code = run(
        "replay", str(folder), "--cameras", "2", "--poses", str(poses), "--pipeline", "paper"
    )
    assert code == 0
    table = parquet.read_table(poses)
    assert table.column_names == COLUMNS
    assert table.num_rows == NUM_SLOTS * 17


@each_case("method", ["rts", "butterworth"])
def test_smoothed_poses_are_figures_and_rows(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], method: str
) -> None:
    found = {}
    for name, options in (("plain", []), ("smooth", ["--smooth", method])):
        figures, poses = tmp_path / f"{name}.json", tmp_path / f"{name}.csv"
        written = ["--json", str(figures), "--poses", str(poses)]
        assert run("replay", str(folder), "--cameras", "1", *written, *options) == 0
        found[name] = json.loads(figures.read_text())["metrics"], poses.read_text()
    (plain, rows), (smooth, smoothed) = found["plain"], found["smooth"]
    assert len(rows.splitlines()) == len(smoothed.splitlines()) and rows != smoothed
    assert smooth["acceleration_error_mps2"] < plain["acceleration_error_mps2"]
    assert capsys.readouterr().out.count(f", smoothed ({method})") == 1


def moved(recording: Recording, R: Any = UPRIGHT, scale: float = 1.0, shrink: int = 1) -> Recording:
    """Return a recording with a calibration in other axes, units or pixels, and no truth."""
    smaller = np.diag([1 / shrink, 1 / shrink, 1.0])
    cameras = tuple(
        Camera.from_world_to_camera(
            c.camera_id, (c.image_size[0] // shrink, c.image_size[1] // shrink), smaller @ c.K,
            c.R @ np.asarray(R).T, scale * c.t,
        )
        for c in recording.rig.cameras
    )  # fmt: skip
    return replace(recording, rig=Rig(cameras), truth=None)


def test_every_verb_that_acts_says_what_info_knows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    walking = walk(3, people=2, seconds=5.0, fps=8.0)
    later = replace(
        walking.views[2], slots=walking.views[2].slots + 16, times_s=walking.views[2].times_s + 2
    )
    views = (*walking.views[:2], later, walking.views[3])
    cases = {
        "units": (moved(walking, scale=10.0), "people would be 1"),
        "axes": (moved(walking, [[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]), "--up=-y"),
        "pixels": (moved(walking, shrink=2), "keypoints lie outside the"),
        "later": (
            replace(walking, num_slots=walking.num_slots + 16, views=views, truth=None),
            "off where most other cameras",
        ),
        "fine": (replace(walking, truth=None), ""),
    }
    for name, (recording, words) in cases.items():
        folder, rig, source = tmp_path / name, tmp_path / f"{name}.toml", tmp_path / f"{name}-json"
        save_recording(recording, folder)
        save_rig(recording.rig, rig)
        for camera, series in zip(recording.rig.camera_ids, recording.views, strict=True):
            (source / camera).mkdir(parents=True)
            for slot in range(recording.num_slots):
                view = series.view(slot)
                if view is not None:
                    rows = np.nan_to_num(np.dstack([view.keypoints_px, view.scores]))
                    people = [{"pose_keypoints_2d": each.ravel().tolist()} for each in rows]
                    content = json.dumps({"people": people})
                    (source / camera / f"{slot}_keypoints.json").write_text(content)
        poses, known = tmp_path / f"{name}.csv", ("--calibration", rig)
        for verb in (
            ("info", folder),
            ("import", "openpose", source, tmp_path / f"{name}-2", *known, "--fps", 8),
            ("replay", folder, "--poses", poses),
            *([("export", poses, tmp_path / f"{name}.trc")] if name in ("axes", "fine") else []),
            *([("calibrate", "check", folder)] if name in ("units", "fine") else []),
        ):
            code = run(*verb)
            said = " ".join("".join(capsys.readouterr()).split())
            assert words in said, (name, verb, said)
            if (name, verb[0]) == ("units", "replay"):  # nobody is a result
                assert code == Exit.NOBODY and "found nobody: " in said and poses.is_file()
            assert "align CALIBRATION" not in said, verb
            if not words:
                wrong = "people would|lie outside|off where most|along world z"
                assert not re.search(wrong, said), (verb, said)


def test_a_camera_that_saw_nobody_is_not_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    walking = walk(3, seconds=6.0, fps=12.0)
    nobody = ViewSeries.from_views(
        [Poses2D.empty(17)] * 72, range(72), (np.arange(72) / 12).tolist(), 17
    )
    views = (*walking.views[:3], nobody)
    save_recording(replace(walking, views=views, truth=None), tmp_path / "rec")
    assert run("calibrate", "check", tmp_path / "rec") == 0
    found = capsys.readouterr().out
    assert "cam3    no person seen that others saw: not judged" in found and "nan" not in found


def test_cameras_without_a_place_are_named_and_left_out(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = load_recording(folder)
    unplaced = replace(whole, rig=Rig(whole.rig.cameras, unplaced=("c1",)), truth=None)
    save_recording(unplaced, tmp_path / "rec")
    save_rig(unplaced.rig, tmp_path / "rig.toml")
    for number in range(4):
        people = [{"pose_keypoints_2d": [200.0 + number, 300.0, 0.5] * 17}]
        (tmp_path / f"in/c{number}").mkdir(parents=True)
        (tmp_path / f"in/c{number}/0.json").write_text(json.dumps({"people": people}))
    options = ("--calibration", tmp_path / "rig.toml", "--fps", 25)
    assert run("import", "detections", tmp_path / "in", tmp_path / "too", *options) == 0
    assert "c1: has no place, so replay leaves it out" in capsys.readouterr().err
    assert run("info", tmp_path / "rec") == 0
    said = capsys.readouterr().out
    assert "c1: has no place, so replay leaves it out" in said and said.count("unknown") == 2
    assert run("replay", tmp_path / "rec", "--cameras", 2) == 0
    found = capsys.readouterr()
    assert "left out without a place: c1" in found.err and "c1" not in found.out


def test_noise_of_another_detector_is_a_hint(folder: Path) -> None:
    for file, factors, told in (
        ("openpose", {"a": 0.3, "b": 2.7, "c": 1.0}, True),
        ("openpose", {"a": 0.3, "b": 1.1, "c": 1.0}, False),
        ("unknown", {"a": 0.3, "b": 2.7, "c": 1.0}, False),
    ):
        lines = noise_lines(SimpleNamespace(noise=NoiseFound(file, factors)))  # type: ignore[arg-type]
        assert ("are these keypoints of openpose?" in " ".join(lines)) == told


def test_people_who_lie_are_told_with_the_axes() -> None:
    walking, noise = walk(3, seconds=4.0, fps=12.0), load_noise("openpose")
    assert doubt_people(walking, noise) == ""
    y_down = [[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]
    assert "up is along -y, expected z" in str(doubt_people(moved(walking, y_down), noise))
    z_down = [[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]]
    assert "up is along -z, expected z" in str(doubt_people(moved(walking, z_down), noise))
