from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.cli.commands import run
from tests.recording.detections.test_detections import rig_of

from e3pose.recording import load_recording


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """Two cameras, two frames, one person in each view."""
    rig_of(tmp_path, "cam1", "cam2")
    person = {"pose_keypoints_2d": [200.0, 300.0, 0.5] * 17}
    for camera in ("cam1_json", "other"):
        (tmp_path / "json" / camera).mkdir(parents=True)
        for frame in (0, 1):
            path = tmp_path / "json" / camera / f"{frame}_keypoints.json"
            path.write_text(json.dumps({"people": [person]}))
    return tmp_path


def test_openpose_makes_a_recording(source: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("import", "openpose", source / "json", source / "rec", "--calibration",
                 source / "rig.toml", "--fps", 60, "--folder", "cam2=other")  # fmt: skip
    assert run(*arguments) == 0
    recording = load_recording(source / "rec")
    assert (recording.num_slots, recording.fps, recording.name) == (2, 60.0, "json")
    assert "2 cameras, 2 slots at 60 fps, 4 2D poses (coco17)" in capsys.readouterr().out
    assert run(*arguments) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert run(*arguments, "--overwrite") == 0


def test_coco_makes_a_recording(source: Path) -> None:
    result = {"image_id": "cam1/4.jpg", "category_id": 1, "keypoints": [200.0, 300.0, 0.5] * 17}
    (source / "results.json").write_text(json.dumps([result]))
    assert run("import", "coco", source / "results.json", source / "rec", "--calibration",
                source / "rig.toml", "--fps", 30) == 0  # fmt: skip
    recording = load_recording(source / "rec")
    assert [len(series.scores) for series in recording.views] == [1, 0]


@pytest.mark.shared
def test_shelf_and_panoptic_survive_the_folder(tmp_path: Path, shared: Path) -> None:
    data = shared / "data"
    assert run("import", "shelf", data / "shelf/shelf.npz", tmp_path / "shelf") == 0
    shelf = load_recording(tmp_path / "shelf")
    assert (shelf.num_slots, shelf.truth_complete) == (301, False)
    assert run("import", "panoptic", data / "panoptic/160906_band1.npz", tmp_path / "band",
                "--cameras", "3, 00_06", "--project-truth") == 0  # fmt: skip
    band = load_recording(tmp_path / "band")
    assert band.rig.camera_ids == ("00_03", "00_06")
    assert band.truth_complete
