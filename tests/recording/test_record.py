"""A recording in memory, and the processor time that goes with it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import (
    ProcessorTime,
    Recording,
    Truth,
    ViewSeries,
    load_recording,
    save_recording,
)
from e3pose.recording.processor import FILE, load_processor


def test_a_lost_view_is_none_and_an_empty_one_is_not() -> None:
    series = ViewSeries.from_views([Poses2D.empty(17)], [3], [0.1], 17)
    assert series.view(2) is None
    assert series.view(4) is None
    view = series.view(3)
    assert view is not None
    assert len(view) == 0


@each_case(
    ("change", "message"),
    [
        ({"fps": 0.0}, "fps is 0"),
        ({"fps": float("nan")}, "fps is nan"),
        ({"num_slots": 39}, r"cam0: slots 0\.\.39 lie outside"),
        ({"views": ()}, "views of 0 cameras"),
        ({"scored_slots": (5, 41)}, "scored_slots: found 5..41"),
        ({"scored_slots": (-1, 4)}, "scored_slots: found -1..4"),
        ({"videos": {"eve": "a.mp4"}}, "camera: found 'eve', which is not in the rig"),
        ({"videos": {"cam0": "../../secret.mp4"}}, r"videos.cam0: found '../../secret.mp4'"),
        ({"videos": {"cam0": "a/b.mp4"}}, "videos.cam0"),
        ({"videos": {"cam0": ".."}}, "videos.cam0"),
        ({"videos": {"cam0": ""}}, "videos.cam0"),
        ({"name": "\x1b[2Jgone"}, "name: found 8 characters"),
        ({"name": "x" * 201}, "name: found 201"),
        ({"source": "\x07"}, "source: found 1"),
    ],
)
def test_what_does_not_fit_is_refused(
    scene: Recording, change: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        replace(scene, **change)


@each_case(
    ("person_ids", "message"),
    [
        (("ann",), "truth has shape"),
        (("ann", "ann"), "1 differ"),
        (("ann", ""), "found ''"),
        (("ann", "b\nb"), "printable"),
    ],
)
def test_people_of_a_truth_have_names(
    scene: Recording, person_ids: tuple[str, ...], message: str
) -> None:
    assert scene.truth is not None
    with pytest.raises(InputError, match=message):
        replace(scene, truth=Truth(COCO17, person_ids, scene.truth.joints_m))


@each_case(
    ("change", "message"),
    [
        ({"times_s": np.zeros(3)}, "different lengths"),
        ({"times_s": np.full(40, np.nan)}, "time is not a number"),
        ({"slots": np.zeros(40, dtype=np.int64)}, "slots are not increasing"),
        ({"starts": np.zeros(41, dtype=np.int64)}, "do not fit together"),
        ({"keypoints_px": np.zeros((80, 5, 2)), "scores": np.zeros((80, 5))}, "of 5 joints"),
    ],
)
def test_a_broken_series_is_named_by_camera(
    scene: Recording, change: dict[str, Any], message: str
) -> None:
    views = (scene.views[0], replace(scene.views[1], **change), *scene.views[2:])
    with pytest.raises(InputError, match=f"cam1: .*{message}"):
        replace(scene, views=views)


def test_annotated_needs_all_three_coordinates() -> None:
    joints_m = np.zeros((1, 1, 17, 3))
    joints_m[0, 0, 4, 1] = np.nan
    annotated = Truth(COCO17, ("ann",), joints_m).annotated
    assert annotated.shape == (1, 1, 17)
    assert np.flatnonzero(~annotated[0, 0]).tolist() == [4]


TIMES = {"cam0": ProcessorTime(0.168, 0.015, 30), "cam2": ProcessorTime(0.2, 0.0, 1)}


def test_what_was_measured_comes_back(scene: Recording, tmp_path: Path) -> None:
    save_recording(replace(scene, processor=TIMES), tmp_path / "rec")
    assert load_recording(tmp_path / "rec").processor == TIMES


def test_nothing_is_written_where_nothing_was_measured(scene: Recording, tmp_path: Path) -> None:
    save_recording(scene, tmp_path / "rec")
    assert not (tmp_path / "rec" / FILE).exists()
    assert load_recording(tmp_path / "rec").processor == {}


@each_case(
    "old, new, named",
    [
        ("cam2", "cam9", "cam9"),
        ("version = 1", "version = 2", "version"),
        ("looks = 30", "looks = 0", "0 looks"),
        ("look_s = 0.168", "look_s = -1.0", "-1.0"),
        ("look_s = 0.168", "look_s = nan", "nan"),
        ("look_s = 0.168", "", "look_s"),
        ("[cameras", "[[", FILE),
    ],
)
def test_a_broken_file_is_named(
    scene: Recording, tmp_path: Path, old: str, new: str, named: str
) -> None:
    save_recording(replace(scene, processor=TIMES), tmp_path / "rec")
    file = tmp_path / "rec" / FILE
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=FILE) as error:
        load_recording(tmp_path / "rec")
    assert named in str(error.value)


def test_the_documented_example_is_one(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs/reference/recording-format.md").read_text()
    _, example = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    (tmp_path / FILE).write_text(example)
    assert load_processor(tmp_path, ("cam1",)) == {"cam1": ProcessorTime(0.168, 0.015, 30)}
