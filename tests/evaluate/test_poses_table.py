"""The table of poses, on people whose every number is known."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from e3pose.base.errors import InputError
from e3pose.evaluate.poses_table import write_poses
from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.pipeline import SlotRecord

NONE = np.zeros(3, dtype=bool)


def record(slot: int, people: People) -> SlotRecord:
    none = np.zeros(3)
    return SlotRecord(slot, slot / 25, NONE, NONE, people, none, none, NONE)


def test_rows_name_slot_track_and_joint(tmp_path: Path) -> None:
    joints = np.full((2, 17, 3), np.nan)
    scores = np.zeros((2, 17))
    joints[0, 5], scores[0, 5] = [1.0, 2.0, 3.0], 0.5
    joints[1, 0], scores[1, 0] = [-1.0, 0.123456, 0], 1.0
    records = [
        record(0, People.empty(17)),
        record(3, People(np.array([7, 4]), joints, scores)),
    ]
    write_poses(records, COCO17, tmp_path / "poses.csv")
    rows = list(csv.DictReader((tmp_path / "poses.csv").read_text().splitlines()))
    assert [(r["slot"], r["time"], r["track"], r["joint"]) for r in rows] == [
        ("3", "0.12", "7", "left_shoulder"),
        ("3", "0.12", "4", "nose"),
    ]
    assert [float(rows[0][axis]) for axis in "xyz"] == [1, 2, 3]
    assert float(rows[1]["y"]) == 0.12346
    assert float(rows[0]["score"]) == 0.5


def test_nobody_is_a_table_without_rows(tmp_path: Path) -> None:
    write_poses([record(0, People.empty(17))], COCO17, tmp_path / "poses.csv")
    text = (tmp_path / "poses.csv").read_text()
    assert text.strip() == "slot,time,track,joint,x,y,z,score,measured,sigma"


def test_unknown_ending_is_refused_and_nothing_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="parquet"):
        write_poses([], COCO17, tmp_path / "poses.pkl")
    assert list(tmp_path.iterdir()) == []
