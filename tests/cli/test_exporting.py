"""`e3pose export` as a user runs it."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run
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
