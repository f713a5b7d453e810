"""A recording that is written while it happens is one, also if its program was killed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.rigs import looking

from e3pose.base.errors import InputError
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import load_recording
from e3pose.recording.calibration.world import assumed_rig
from e3pose.recording.writer import RecordingWriter, finish_interrupted

RIG = looking((4, 0), (0, 4), (-4, 0))


def person(x: float) -> Poses2D:
    return Poses2D(np.full((1, 17, 2), x), np.full((1, 17), 0.5))


def begun(folder: Path) -> RecordingWriter:
    """Return a recording of which camera c0 has three slots, c1 one and c2 none."""
    writer = RecordingWriter(folder / "walk", RIG, 20.0, COCO17, "openpose", "A walk.")
    for slot in (0, 1, 4):
        writer.add("c0", slot, slot / 20, person(10.0 + slot))
    writer.add("c1", 2, 0.11, Poses2D.empty(17))
    return writer


def check(folder: Path) -> None:
    recording = load_recording(folder)
    assert recording.num_slots == 5 and recording.fps == 20
    assert (recording.detector, recording.source, recording.name) == ("openpose", "A walk.", "walk")
    assert [series.slots.tolist() for series in recording.views] == [[0, 1, 4], [2], []]
    view = recording.view(4, 0)
    assert view is not None and view.keypoints_px[0, 0, 0] == 14.0
    assert recording.views[1].times_s.tolist() == [0.11]


def test_finished_recording_has_its_name(tmp_path: Path) -> None:
    writer = begun(tmp_path)
    assert not (tmp_path / "walk").exists()
    assert writer.finish() == tmp_path / "walk"
    check(tmp_path / "walk")
    assert [path.name for path in tmp_path.iterdir()] == ["walk"]


def test_recording_that_a_kill_cut_off_is_put_right(tmp_path: Path) -> None:
    writer = begun(tmp_path)
    writer.close()
    with (writer.folder / "keypoints" / "c0.jsonl").open("ab") as file:
        file.write(b'{"slot":5,"time":0.2')  # torn
    with pytest.raises(InputError, match="unfinished work of another program"):
        begun(tmp_path)
    assert finish_interrupted(tmp_path) == [tmp_path / "walk"]
    check(tmp_path / "walk")
    assert finish_interrupted(tmp_path) == []


def test_recording_without_a_view_is_none(tmp_path: Path) -> None:
    assert RecordingWriter(tmp_path / "walk", RIG, 20.0, COCO17).finish() is None
    RecordingWriter(tmp_path / "cut", RIG, 20.0, COCO17).close()
    assert finish_interrupted(tmp_path) == []
    assert not list(tmp_path.iterdir())


def test_strangers_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.partial").mkdir()
    (tmp_path / "mine.partial" / "recording.toml").write_text("mine")
    assert finish_interrupted(tmp_path) == []
    assert (tmp_path / "mine.partial" / "recording.toml").read_text() == "mine"


def test_cameras_that_nobody_placed_stay_so(tmp_path: Path) -> None:
    rig = assumed_rig({"c0": (640, 480), "c1": (640, 480)})
    with RecordingWriter(tmp_path / "walk", rig, 20.0, COCO17) as writer:
        writer.add("c0", 0, 0.0, person(5.0))
    loaded = load_recording(tmp_path / "walk").rig
    assert not loaded.placed and loaded.cameras[0].image_size == (640, 480)
