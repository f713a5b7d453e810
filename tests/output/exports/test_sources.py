"""Where takes come from: tables and stores, by time, person and place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest
import tomli_w
from pyarrow import parquet
from tests.cases import each_case
from tests.output.exports.takes import MISSING_FRAMES, STARTED_NS, records, take

from e3pose.base.errors import InputError
from e3pose.estimate.smooth import SmoothSettings, smoothed
from e3pose.evaluate.poses_table import write_poses
from e3pose.model.skeleton import COCO17, load_skeleton, own_file, skeleton_table
from e3pose.model.take import FILLED, MEASURED, PREDICTED
from e3pose.output.archive.writing import Hour, file_of
from e3pose.output.exports import ExportSettings, export, source
from e3pose.output.exports.resample import resampled
from e3pose.output.exports.source import Asked, take_from_store, take_from_table
from e3pose.store import Run, Store, StoreWriter

TAKE = take()
CAMERAS = ("a", "b")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("store") / "live.db"
    run = Run("lab", "a run", STARTED_NS, 0.04, "coco17", COCO17.joints, CAMERAS)
    with StoreWriter(str(path), run) as writer:
        for record in records():
            writer.append(record, wait=True)
    return path


@each_case("ending", ["csv", "parquet"])
def test_a_table_of_replay_gives_the_take_back(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"poses.{ending}"
    write_poses(records(), COCO17, path)
    found = take_from_table(path, Asked())
    assert found.skeleton == COCO17 and found.interval_s == pytest.approx(0.04)
    assert found.started_ns is None
    for motion, wanted in zip(found.motions, TAKE.motions, strict=True):
        assert (motion.track_id, motion.first) == (wanted.track_id, wanted.first)
        np.testing.assert_allclose(motion.joints_m, wanted.joints_m, atol=1e-5)
        np.testing.assert_array_equal(motion.origin, wanted.origin)
        np.testing.assert_allclose(motion.sigma_m, np.where(wanted.known, 0.012, np.nan), atol=1e-5)
    # One that was exported has dates.
    path.unlink()
    list(export(TAKE, path, ending))
    found = take_from_table(path, Asked(tracks=(7,)))
    (motion,), wanted = found.motions, TAKE.motions[1]
    assert (found.started_ns, motion.first) == (STARTED_NS, wanted.first)
    np.testing.assert_allclose(motion.joints_m, wanted.joints_m, atol=1e-5)


def test_a_store_gives_the_take_back(store: Path) -> None:
    found = take_from_store(str(store), Asked())
    assert found.name == "a run" and found.started_ns == STARTED_NS
    for motion, wanted in zip(found.motions, TAKE.motions, strict=True):
        assert (motion.track_id, motion.first) == (wanted.track_id, wanted.first)
        np.testing.assert_allclose(motion.joints_m, wanted.joints_m, atol=1e-6)
        np.testing.assert_array_equal(motion.origin, wanted.origin)
    origin = smoothed(found, SmoothSettings("rts", fill_s=0.2)).motions[0].origin
    assert (origin[MISSING_FRAMES, 9] == FILLED).all() and (origin == FILLED).sum() == 4


def test_a_skeleton_of_ones_own_keeps_its_limbs(tmp_path: Path) -> None:
    text = skeleton_table(COCO17) | {"name": "mine", "limbs": ["nose left_wrist left_ankle"]}
    (tmp_path / "mine.toml").write_text(tomli_w.dumps(text))
    mine = load_skeleton(tmp_path / "mine.toml")
    (tmp_path / "mine.toml").unlink()
    store, archive = tmp_path / "live.db", tmp_path / "walk.parquet"
    run = Run("lab", "a run", STARTED_NS, 0.04, "mine", mine.joints, CAMERAS, "", own_file(mine))
    with StoreWriter(str(store), run) as writer:
        for record in records():
            writer.append(record, wait=True)
    found = take_from_store(str(store), Asked())
    assert found.skeleton == mine and len(mine.limbs) == 2
    list(export(found, archive, "parquet", ExportSettings(layout="archive")))
    assert take_from_table(archive, Asked()).skeleton == mine
    (one,) = Store(store).runs()
    assert file_of(Store(store), Hour(one, STARTED_NS, 1))[1].skeleton == "mine"
    for wrong, message in (("{", "JSON"), (own_file(mine).replace("nose", "chin"), "of its poses")):
        with pytest.raises(InputError, match=message):
            _ = replace(run, own_skeleton=wrong).limbed
    assert own_file(COCO17) == ""


def test_time_person_and_place_choose(store: Path, tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    write_poses(records(), COCO17, path)
    asked = Asked(start="0.4", end="0.8", tracks=(7,))
    for found in (take_from_store(str(store), asked), take_from_table(path, asked)):
        (motion,) = found.motions
        assert (motion.track_id, motion.first, len(motion)) == (7, 10, 11)
    low, high = 0.2, 0.4  # metres that the first one walks, beside the second
    found = take_from_table(path, Asked(region_m=(high, 0.3, low, -0.3)))
    (motion,) = found.motions
    assert motion.track_id == 3
    middle = np.nanmean(motion.joints_m[:, :, 0], axis=1)
    assert ((middle >= low - 1e-5) & (middle <= high + 1e-5)).all()


@each_case(
    ("asked", "message"),
    [
        (Asked(tracks=(99,)), "found no poses that fit"),
        (Asked(start="50"), "found no poses that fit"),
        (Asked(region_m=(50, 50, 51, 51)), "found no poses that fit"),
        (Asked(start="14:00"), "no dates"),
        (Asked(run=3), "expected a store"),
    ],
)
def test_what_a_table_does_not_hold_is_reported(tmp_path: Path, asked: Asked, message: str) -> None:
    path = tmp_path / "poses.csv"
    write_poses(records(), COCO17, path)
    with pytest.raises(InputError, match=message):
        take_from_table(path, asked)


@each_case(
    ("text", "message"),
    [
        ("", "expected a table of poses"),
        ("a,b\n1,2\n", "found no column slot"),
        ("slot,time,track,joint,x,y,z\n", "found 0 rows"),
        ("slot,time,track,joint,x,y,z\n1,0,0,tail,1,2,3\n2,1,0,tail,1,2,3\n", "joints tail"),
        ("slot,time,track,joint,x,y,z\n1,0.04,0,nose,1,2,3\n", "one slot"),
        ("slot,time,track,joint,x,y,z\n1,3,0,nose,1,2,3\n2,3,0,nose,1,2,3\n", "rising times"),
        ("slot,time,track,joint,x,y,z\n" + "1,1,0,nose,1,2,3\n" * 2 + "2,2,0,nose,1,2,3\n",
         "joint twice"),
        ("slot,time,track,joint,x,y,z,score\n1,1,0,nose,1,2,3,7\n2,2,0,nose,1,2,3,1\n", "score"),
        ("slot,time,track,joint,x,y,z,score\n1,1,0,nose,1,2,3,sure\n2,2,0,nose,1,2,3,1\n", "score"),
    ],
)  # fmt: skip
def test_tables_of_something_else_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "poses.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        take_from_table(tmp_path / "poses.csv", Asked())


@each_case(
    ("column", "values", "most_rows", "message"),
    [
        ("", None, 3, "found 4 rows, expected 1 to 3"),
        ("x", None, 100, "found no column x"),
        ("joint", [1, 2, 3, 4], 100, "joint: found int64"),
        ("y", [[1.0] * 9] * 4, 100, "y: found list"),
        ("z", ["far"] * 4, 100, "z: found string"),
    ],
)
def test_what_is_no_table_of_poses_is_refused_before_a_row_of_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, column: str, values: list[Any] | None,
    most_rows: int, message: str,
) -> None:  # fmt: skip
    """A file of 1.4 MB took 3 GB and 31 s, as its columns were looked at afterwards."""
    columns = {name: [0.0, 1.0, 2.0, 3.0] for name in ("slot", "track", "time", "x", "y", "z")}
    table: dict[str, list[Any]] = {**columns, "joint": ["nose"] * 4, "other": [0] * 4}
    table = {name: one for name, one in table.items() if name != column or values is not None}
    table |= {column: values} if values is not None else {}
    parquet.write_table(pyarrow.table(table), tmp_path / "a.parquet")
    monkeypatch.setattr(source, "MAX_ROWS", most_rows)
    for reads in ("read_table", "read_pandas"):
        monkeypatch.setattr(parquet, reads, lambda *_, **__: pytest.fail("it was read"))
    with pytest.raises(InputError, match=message):
        take_from_table(tmp_path / "a.parquet", Asked())


def test_too_many_wide_rows_are_refused_unread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ((path, _),) = export(TAKE, tmp_path / "a.parquet", "parquet", ExportSettings(layout="archive"))
    assert take_from_table(path, Asked()).skeleton == COCO17
    monkeypatch.setattr(source, "MAX_ROWS", 17 * 20)
    with pytest.raises(InputError, match="rows, expected at most 20"):
        take_from_table(path, Asked())


def test_rows_without_a_run_are_of_one_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "poses.parquet"
    write_poses(records(), COCO17, path)
    table = parquet.read_table(path)
    nothing = pyarrow.nulls(table.num_rows, pyarrow.int64())
    parquet.write_table(table.append_column("run", nothing), path)
    monkeypatch.setattr(source, "BATCH", 99)
    assert len(take_from_table(path, Asked()).motions) == 2


@pytest.mark.parametrize("layout", ["long", "archive"])
def test_all_people_together_fit_into_memory_or_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, layout: Any
) -> None:
    ((path, _),) = export(TAKE, tmp_path / "a.parquet", "parquet", ExportSettings(layout=layout))
    monkeypatch.setattr("e3pose.model.take.MAX_JOINTS_HELD", 17 * 60)  # either of the two fits
    with pytest.raises(InputError) as refused:
        take_from_table(path, Asked())
    found = "all tracks: found 74 slots from first to last, expected at most 60"
    assert str(refused.value) == f"{path}: {found}"


def test_poses_of_several_runs_are_not_one_take(store: Path, tmp_path: Path) -> None:
    import shutil

    path = Path(shutil.copy(store, tmp_path / "two.db"))
    run = Run("lab", "later", STARTED_NS + 10**12, 0.04, "coco17", COCO17.joints, CAMERAS)
    with StoreWriter(str(path), run) as writer:
        for record in records()[:3]:
            writer.append(record, wait=True)
    with pytest.raises(InputError, match=r"runs 1 \(lab, a run\), 2 \(lab, later\)"):
        take_from_store(str(path), Asked())
    assert take_from_store(str(path), Asked(run=2)).name == "later"


def test_frames_between_slots_lie_on_lines_and_gaps_stay() -> None:
    found = resampled(TAKE, 50.0)
    first, second = found.motions
    assert (first.first, second.first, len(first)) == (0, 12, 79)
    np.testing.assert_allclose(first.joints_m[::2], TAKE.motions[0].joints_m)
    middle = (TAKE.motions[0].joints_m[3] + TAKE.motions[0].joints_m[4]) / 2
    np.testing.assert_allclose(first.joints_m[7], middle)
    gap = slice(2 * MISSING_FRAMES.start - 1, 2 * MISSING_FRAMES.stop)
    assert np.isnan(first.joints_m[gap, 9]).all() and np.isfinite(first.joints_m[gap, 8]).all()
    assert (first.origin[39, 0], first.origin[38, 0]) == (PREDICTED, MEASURED)
    slow = resampled(TAKE, 10.0)
    np.testing.assert_allclose(slow.motions[0].joints_m[2], TAKE.motions[0].joints_m[5])
    assert resampled(TAKE, 25.0) is TAKE
    with pytest.raises(InputError, match="--fps: found 0"):
        resampled(TAKE, 0.0)
