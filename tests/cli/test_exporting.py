"""`e3pose export` as a user runs it."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case
from tests.cli.commands import refused, run
from tests.output.exports.takes import STARTED_NS, records

from e3pose.evaluate.poses_table import write_poses
from e3pose.model.skeleton import COCO17
from e3pose.store import Run, StoreWriter


@pytest.fixture(scope="module")
def poses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("poses") / "poses.csv"
    write_poses(records(), COCO17, path)
    return path


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("store") / "live.db"
    run_ = Run("lab", "a run", STARTED_NS, 0.04, "coco17", COCO17.joints, ("a", "b"))
    with StoreWriter(str(path), run_) as writer:
        for record in records():
            writer.append(record, wait=True)
    return path


def test_files_are_named_with_what_they_hold(
    poses: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("export", str(poses), str(tmp_path / "walk.trc")) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == f"Wrote {tmp_path}/walk-track3.trc: mm, y up"
    assert said[1] == f"Wrote {tmp_path}/walk-track7.trc: mm, y up"
    assert said[2].endswith("predicted by the estimator, not measured in their frame")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["walk-track3.trc", "walk-track7.trc"]


def test_a_store_is_smoothed_filled_and_resampled(
    store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dest = tmp_path / "walk.csv"
    code = run(
        "export", str(store), str(dest), "--smooth", "rts", "--fill", "200ms", "--fps", "50",
        "--angles", "--track", "3",
    )  # fmt: skip
    assert code == 0
    said = capsys.readouterr().out
    assert "resampled from 25 to 50 frames per second, linearly" in said
    assert "% of the joints filled" in said
    rows = list(csv.DictReader(dest.read_text().splitlines()))
    assert len(rows) == 79 and {row["track"] for row in rows} == {"3"}
    assert [row["left_wrist_origin"] for row in rows[20:28:2]] == ["filled"] * 4
    assert {row["nose_origin"] for row in rows} == {"measured", "predicted"}
    angles = [float(row["left_knee_flexion_deg"]) for row in rows]
    assert np.ptp(angles) < 20
    assert dest.stat().st_mode & 0o077 == 0  # where people were is for its owner alone


@each_case(
    ("options", "message"),
    [
        (["walk.docx"], "'.docx'"),
        (["walk.trc", "--format", "c3d"], "expected .c3d"),
        (["walk.trc", "--angles"], "--angles: found with trc"),
        (["walk.csv", "--units", "m"], "--units: found with csv"),
        (["walk.trc", "--names", "vrm"], "--names vrm: found with trc, expected bvh or gltf"),
        (["walk.csv", "--layout", "archive"], "--layout archive: found with csv, expected parquet"),
        (["walk.trc", "--layout", "wide"], "--layout: found with trc, expected csv or parquet"),
        (
            ["walk.csv", "--layout", "long", "--angles"],
            "--layout long: found with csv, expected no",
        ),
        (["walk.c3d", "--names", "opencap"], "--names opencap: found with c3d, expected trc"),
        (["walk.trc", "--calibration", "rig.toml"], "--calibration: found with trc"),
        (["walk.json"], "--calibration FILE"),
        (["walk.trc", "--track", "99"], "found no poses that fit"),
        (["walk.trc", "--region", "1,2,3"], "--region: found '1,2,3'"),
        (["walk.trc", "--fill", "2"], "--fill: found '2'"),
        (["walk.trc", "--fps", "0"], "--fps: found 0"),
        (["walk.trc", "--smooth", "butterworth", "--cutoff", "20Hz"], "less than 10 Hz"),
        (["walk.trc", "--cutoff", "6Hz"], "--cutoff: found without"),
        (["walk.trc", "--from", "14:00"], "no dates"),
        (["walk.trc", "--run", "1"], "--run"),
        (["none/walk.trc"], "found no folder"),
    ],
)
def test_wrong_options_are_one_line_and_nothing_is_written(
    poses: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    message: str,
) -> None:
    assert message in refused(capsys, "export", poses, tmp_path / options[0], *options[1:])
    assert list(tmp_path.iterdir()) == []


def test_sources_that_are_none_are_named(
    poses: Path, store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "recording.toml").write_text("")
    for source, dest, message in (
        (tmp_path / "none.db", "w.trc", "none.db"),
        (tmp_path / "none.csv", "w.trc", "no such file"),
        (tmp_path, "w.trc", "e3pose replay"),
    ):
        assert run("export", str(source), str(tmp_path / dest)) == 2
        assert message in capsys.readouterr().err
    assert run("export", str(poses), str(poses)) == 2
    assert "the source itself" in capsys.readouterr().err
    assert run("export", str(store), str(tmp_path / "w.trc"), "--site", "other") == 2
    assert "--site: found 'other'" in capsys.readouterr().err
