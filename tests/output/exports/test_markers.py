"""TRC, C3D and tables, read back by readers that know nothing of us."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from tests.cases import each_case
from tests.output.exports.takes import FPS, MISSING_FRAMES, MISSING_JOINT, STARTED_NS, take

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.model.take import MEASURED, MISSING, Take, motions_of
from e3pose.output.exports import EXPORTS, ExportSettings, export, format_of
from e3pose.output.exports.c3d import CHUNK_FRAMES, MAX_FRAMES

TAKE = take()
FIRST, SECOND = TAKE.motions


def read_trc(path: Path) -> tuple[dict[str, str], list[str], Floats, Floats]:
    """Read a TRC file as OpenSim 4.6 does: an empty cell at the end of a row is no cell.

    Returns:
        The header, marker names, times, and `(num_frames, num_markers, 3)` as written.
    """
    lines = path.read_text().split("\n")
    assert lines[0].split("\t")[:3] == ["PathFileType", "4", "(X/Y/Z)"]
    header = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=True))
    cells = lines[3].split("\t")
    assert cells[:2] == ["Frame#", "Time"]
    names = [name for name in cells[2:] if name]
    assert cells[2::3] == names and len(names) == int(header["NumMarkers"])
    axes = [cell for cell in lines[4].split("\t") if cell]
    assert axes == [f"{axis}{n + 1}" for n in range(len(names)) for axis in "XYZ"]
    assert lines[5] == ""
    rows = [line.rstrip("\t").split("\t") for line in lines[6:] if line]
    assert [row[0] for row in rows] == [str(n + 1) for n in range(int(header["NumFrames"]))]
    assert {len(row) for row in rows} == {2 + 3 * len(names)}
    values = [[float(cell) for cell in row[2:]] for row in rows]
    times = np.array([float(row[1]) for row in rows])
    return header, names, times, np.array(values).reshape(len(rows), len(names), 3)


def z_up(points: Floats) -> Floats:
    """Return points of a file with y up in the axes of the world."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


@each_case(("units", "scale"), [(None, 1000.0), ("mm", 1000.0), ("m", 1.0)])
def test_trc_has_a_file_a_person_and_nan_where_missing(
    tmp_path: Path, units: Literal["mm", "m"] | None, scale: float
) -> None:
    settings = ExportSettings(units=units)
    written = [path for path, _ in export(TAKE, tmp_path / "walk.trc", "trc", settings)]
    assert [path.name for path in written] == ["walk-track3.trc", "walk-track7.trc"]
    for motion, path in zip(TAKE.motions, written, strict=True):
        header, names, times, points = read_trc(path)
        assert header["Units"] == (units or "mm")
        assert float(header["DataRate"]) == float(header["CameraRate"]) == FPS
        assert tuple(names) == COCO17.joints
        np.testing.assert_allclose(times, (motion.first + np.arange(len(motion))) / FPS, atol=1e-6)
        apart_mm = 1000 * np.abs(z_up(points) / scale - motion.joints_m)
        assert np.nanmax(apart_mm) < 0.001
        np.testing.assert_array_equal(np.isnan(points).any(axis=-1), ~motion.known)


def test_a_trc_row_whose_last_marker_is_missing_is_whole(tmp_path: Path) -> None:
    origin, joints_m = FIRST.origin.copy(), FIRST.joints_m.copy()
    origin[5:8, -1], joints_m[5:8, -1] = MISSING, np.nan
    alone = replace(TAKE, motions=(replace(FIRST, joints_m=joints_m, origin=origin),))
    ((path, _),) = export(alone, tmp_path / "w.trc", "trc")
    *_, points = read_trc(path)
    assert np.isnan(points[5:8, -1]).all() and np.isfinite(points[8, -1]).all()


def test_one_person_has_the_name_that_was_asked_for(tmp_path: Path) -> None:
    alone = replace(TAKE, motions=(SECOND,))
    assert [p.name for p, _ in export(alone, tmp_path / "w.trc", "trc")] == ["w.trc"]


def test_c3d_holds_everybody_and_says_what_is_missing(tmp_path: Path) -> None:
    import ezc3d

    ((path, summary),) = export(TAKE, tmp_path / "walk.c3d", "c3d")
    assert "z up" in summary
    file = ezc3d.c3d(str(path))
    labels = file["parameters"]["POINT"]["LABELS"]["value"]
    assert labels[0] == "track3:nose" and labels[-1] == "track7:right_ankle"
    assert file["parameters"]["POINT"]["RATE"]["value"][0] == FPS
    assert file["parameters"]["POINT"]["UNITS"]["value"] == ["mm"]
    assert file["parameters"]["SUBJECTS"]["NAMES"]["value"] == ["track3", "track7"]
    points = file["data"]["points"][:3].transpose(2, 1, 0).reshape(40, 2, 17, 3)
    residual = file["data"]["meta_points"]["residuals"][0].T.reshape(40, 2, 17)
    for person, motion in enumerate(TAKE.motions):
        rows = slice(motion.first, motion.first + len(motion))
        known = motion.known
        apart_mm = points[rows, person] - 1000 * motion.joints_m
        assert np.abs(apart_mm[known]).max() < 0.001
        assert (residual[rows, person][~known] == -1).all()
        assert (residual[: motion.first, person] == -1).all()
        assert (residual[rows, person][20:25][known[20:25]] == 0).all()
        assert residual[rows, person][0] == pytest.approx(12.0, abs=0.1)


@pytest.mark.parametrize("units", ["mm", "m"])
def test_c3d_in_pieces_holds_what_a_library_writes_at_once(tmp_path: Path, units: str) -> None:
    import ezc3d

    rng, frames = np.random.default_rng(3), 2 * CHUNK_FRAMES + 77
    joints_m = rng.normal(size=(frames, 17, 3))
    joints_m[rng.random((frames, 17)) < 0.2] = np.nan
    # Residuals that both can hold: whole millimetres.
    sigma_m, measured = rng.integers(1, 120, (frames, 17)) / 1000, rng.random((frames, 17)) > 0.3
    first = People(np.full(frames, 1), joints_m, measured=measured, sigma_m=sigma_m)
    second = replace(first, track_ids=np.full(frames, 2))[:40]
    slots = np.concatenate([np.arange(frames), np.arange(CHUNK_FRAMES - 5, CHUNK_FRAMES + 35)])
    motions = motions_of(slots, People.joined([first, second], 17))
    take = Take("long", COCO17, 1 / FPS, motions)
    asked = ExportSettings(units="mm" if units == "mm" else "m")
    ((path, _),) = export(take, tmp_path / "pieces.c3d", "c3d", asked)
    pieces = ezc3d.c3d(str(path))
    per_metre = 1000 if units == "mm" else 1
    whole = ezc3d.c3d(str(path))  # the same parameters, and all of the data by the library
    places = np.zeros((frames, 2, 17, 3))
    residual = np.full((frames, 2, 17), -1.0)
    for person, motion in enumerate(take.motions):
        rows = slice(motion.first, motion.first + len(motion))
        places[rows, person] = np.where(motion.known[..., None], per_metre * motion.joints_m, 0.0)
        steps = np.where(motion.origin == MEASURED, np.round(1000 * motion.sigma_m), 0.0)
        residual[rows, person] = np.where(motion.known, steps, -1.0)
    points = np.ones((4, 34, frames))
    points[:3] = places.reshape(frames, 34, 3).transpose(2, 1, 0)
    whole["data"]["points"] = points
    whole["data"]["meta_points"]["residuals"] = residual.reshape(frames, 34).T[None]
    if units == "mm":
        whole.write(str(tmp_path / "whole.c3d"))
        whole = ezc3d.c3d(str(tmp_path / "whole.c3d"))
        np.testing.assert_array_equal(
            pieces["data"]["meta_points"]["residuals"], whole["data"]["meta_points"]["residuals"]
        )
    else:  # the library writes residuals as multiples of 1 m, which are all 0
        found = pieces["data"]["meta_points"]["residuals"][0].T.reshape(frames, 2, 17)
        expected = np.where(residual < 0, -1.0, residual / 1000)
        np.testing.assert_allclose(found, expected, rtol=1e-6)
    known = residual.reshape(frames, 34).T >= 0
    np.testing.assert_array_equal(
        pieces["data"]["points"][:3, known], points[:3, known].astype(np.float32)
    )


def test_c3d_of_more_frames_than_the_format_counts_is_refused(tmp_path: Path) -> None:
    far = replace(FIRST, first=MAX_FRAMES)
    long = replace(TAKE, motions=(FIRST, far))
    with pytest.raises(InputError, match="found 65575 frames, expected at most 65535"):
        list(export(long, tmp_path / "long.c3d", "c3d"))
    assert list(tmp_path.iterdir()) == []


def test_c3d_of_many_people_keeps_all_labels(tmp_path: Path) -> None:
    import ezc3d

    crowd = replace(TAKE, motions=tuple(replace(FIRST, track_id=n) for n in range(30)))
    ((path, _),) = export(crowd, tmp_path / "crowd.c3d", "c3d")
    file = ezc3d.c3d(str(path))
    point = file["parameters"]["POINT"]
    names = [name for name in ("LABELS", "LABELS2") if name in point]
    labels = [label for name in names for label in point[name]["value"]]
    assert len(labels) == len(set(labels)) == 30 * 17
    assert file["data"]["points"].shape[1] == 30 * 17


def test_csv_and_parquet_hold_a_row_per_frame_and_person(tmp_path: Path) -> None:
    from pyarrow import parquet

    ((path, summary),) = export(TAKE, tmp_path / "walk.csv", "csv", ExportSettings(angles=True))
    assert summary.startswith("74 rows")
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert [row["track"] for row in rows] == ["3"] * 40 + ["7"] * 34
    row = rows[45]
    assert (row["slot"], row["nose_origin"]) == ("11", "measured")
    assert int(row["time_ns"]) == STARTED_NS + 440_000_000
    place = [float(row[f"left_knee_{axis}"]) for axis in "xyz"]
    np.testing.assert_allclose(place, SECOND.joints_m[5, 13], atol=1e-5)
    missing = rows[MISSING_FRAMES.start]
    name = COCO17.joints[MISSING_JOINT]
    assert [missing[f"{name}_{what}"] for what in ("x", "sigma", "score", "origin")] == [""] * 4
    assert missing["left_elbow_flexion_deg"] == "" != missing["right_elbow_flexion_deg"]
    assert rows[20]["nose_origin"] == "predicted"

    ((path, _),) = export(TAKE, tmp_path / "walk.parquet", "parquet", ExportSettings(angles=True))
    table = parquet.read_table(path)
    assert table.column_names == list(rows[0])
    assert table.num_rows == 74
    column = table.column("left_wrist_x").to_pylist()
    assert column[10:14] == [None] * 4
    np.testing.assert_allclose(column[30], FIRST.joints_m[30, 9, 0], atol=1e-5)


@each_case(
    ("name", "form", "message"),
    [
        ("walk.docx", None, "found ending '.docx', expected one of .trc"),
        ("walk", None, "--format openpose"),
        ("walk.trc", "c3d", "expected .c3d"),
        ("walk.c3d", "usd", "expected one of trc"),
    ],
)
def test_a_format_that_does_not_fit_is_named(name: str, form: str | None, message: str) -> None:
    with pytest.raises(InputError, match=message):
        format_of(Path(name), form)


@each_case("name", sorted(EXPORTS))
def test_nobody_is_an_error_and_no_file(tmp_path: Path, name: str) -> None:
    dest = tmp_path / f"walk{(*EXPORTS[name].suffixes, '')[0]}"
    with pytest.raises(InputError, match="found nobody"):
        list(export(Take("empty", COCO17, 0.04, ()), dest, name))
    assert list(tmp_path.iterdir()) == []
