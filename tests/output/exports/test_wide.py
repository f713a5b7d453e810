"""The archive of poses: what is written comes back, and other readers read it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pyarrow
import pytest
from pyarrow import parquet
from tests.cases import each_case
from tests.output.exports.takes import take

from e3pose.base.errors import InputError
from e3pose.estimate.smooth import SmoothSettings, smoothed
from e3pose.model.take import FILLED, Take
from e3pose.output.exports import ExportSettings, export
from e3pose.output.exports.source import Asked, take_from_table
from e3pose.output.exports.wide import KEY

WIDE = ExportSettings(layout="archive")
TAKE = smoothed(take(), SmoothSettings(fill_s=0.2))  # with measured, predicted and filled joints
HALF_MM = 0.0005 + 1e-9


def archive(tmp_path: Path, one: Take = TAKE) -> Path:
    ((path, _),) = export(one, tmp_path / "archive.parquet", "parquet", WIDE)
    return path


def test_what_is_archived_comes_back(tmp_path: Path) -> None:
    found = take_from_table(archive(tmp_path), Asked())
    assert (found.name, found.skeleton, found.started_ns) == (
        "walk",
        TAKE.skeleton,
        TAKE.started_ns,
    )
    assert found.interval_s == TAKE.interval_s
    assert any((motion.origin == FILLED).any() for motion in found.motions)
    for motion, wanted in zip(found.motions, TAKE.motions, strict=True):
        assert (motion.track_id, motion.first) == (wanted.track_id, wanted.first)
        np.testing.assert_array_equal(motion.origin, wanted.origin)
        np.testing.assert_allclose(motion.joints_m, wanted.joints_m, atol=HALF_MM)
        np.testing.assert_allclose(motion.sigma_m, wanted.sigma_m, atol=HALF_MM)
    # Once more, to the byte.
    again = archive(tmp_path / "..", found)
    assert again.read_bytes() == (tmp_path / "archive.parquet").read_bytes()


def test_an_archive_is_asked_as_a_table_is(tmp_path: Path) -> None:
    path = archive(tmp_path)
    (motion,) = take_from_table(path, Asked(start="0.4", end="0.8", tracks=(7,))).motions
    assert (motion.track_id, motion.first, len(motion)) == (7, 10, 11)
    wanted = TAKE.motions[1].joints_m[4:15]
    np.testing.assert_allclose(motion.joints_m, wanted, atol=HALF_MM)
    (motion,) = take_from_table(path, Asked(region_m=(0.2, -0.3, 0.4, 0.3))).motions
    assert motion.track_id == 3 and len(motion) < 40
    with pytest.raises(InputError, match="found no poses that fit"):
        take_from_table(path, Asked(tracks=(99,)))
    with pytest.raises(InputError, match="--angles: found with --layout archive"):
        list(export(TAKE, tmp_path / "a.parquet", "parquet", replace(WIDE, angles=True)))
    assert [*tmp_path.iterdir()] == [path]


def test_columns_are_integers_stored_as_differences(tmp_path: Path) -> None:
    path = archive(tmp_path)
    file = parquet.ParquetFile(path)
    group = file.metadata.row_group(0)
    for index in range(group.num_columns):
        column = group.column(index)
        assert "DELTA_BINARY_PACKED" in column.encodings and column.compression == "ZSTD"
    frame = pandas.read_parquet(path)
    assert len(frame) == 74 and frame.track.tolist() == [3] * 40 + [7] * 34
    row = frame[(frame.track == 7) & (frame.slot == 11)].iloc[0]
    place = [row[f"left_knee_{axis}"] / 1000 for axis in "xyz"]
    np.testing.assert_allclose(place, TAKE.motions[1].joints_m[5, 13], atol=HALF_MM)
    assert row.left_knee_sigma == 12 and row.measured == 2**17 - 1
    assert frame[(frame.track == 3) & (frame.slot == 11)].filled.item() == 1 << 9


def changed(path: Path, **values: Any) -> Path:
    """Write an archive with other metadata, or (`drop`) without a column."""
    table = parquet.read_table(path)
    if "drop" in values:
        table = table.drop_columns([values["drop"]])
    if "twice" in values:
        table = pyarrow.concat_tables([table, table.slice(0, 1)])
    about = {**json.loads(table.schema.metadata[KEY]), **values}
    parquet.write_table(table.replace_schema_metadata({KEY: json.dumps(about)}), path)
    return path


@each_case(
    ("values", "message"),
    [
        ({"version": 2}, "found e3pose-poses-wide version 2, expected e3pose-poses-wide version 1"),
        ({"joints": []}, "metadata: found no joints"),
        ({"interval_s": 0}, "metadata: found no joints"),
        ({"interval_s": "x"}, "metadata: found no joints"),
        ({"started_ns": 1.5}, "metadata: found no joints"),
        ({"drop": "nose_x"}, "found no integer column nose_x"),
        ({"twice": 1}, "track 3: found a slot twice"),
    ],
)
def test_what_no_export_writes_is_refused(
    tmp_path: Path, values: dict[str, Any], message: str
) -> None:
    path = changed(archive(tmp_path), **values)
    with pytest.raises(InputError, match=message):
        take_from_table(path, Asked())
