from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run

from e3pose.model.camera import Camera, Rig
from e3pose.recording import load_recording
from e3pose.recording.calibration import save_rig

SHARED = os.environ.get("E3POSE_SHARED")
needs_shared = pytest.mark.skipif(not SHARED, reason="E3POSE_SHARED is not set")


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """Two cameras, two frames, one person in each view."""
    K = [[900, 0, 640], [0, 900, 360], [0, 0, 1]]
    cameras = tuple(
        Camera.from_world_to_camera(name, (1280, 720), K, np.eye(3), [0.5 * n, 0, 3])
        for n, name in enumerate(("cam1", "cam2"))
    )
    save_rig(Rig(cameras), tmp_path / "rig.toml")
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


@pytest.mark.parametrize(
    ("tokens", "message"),
    [
        (("--fps", "60"), "cameras without a folder: cam2; of no camera: other"),
        (("--fps", "60", "--folder", "cam2:other"), "--folder: found 'cam2:other'"),
        (("--fps", "0", "--folder", "cam2=other"), "--fps: found 0"),
        (("--fps", "fast"), "fps"),
        ((), "fps"),
        (("--fps", "60", "--calibration", "absent.toml"), "absent.toml"),
    ],
)
def test_a_wrong_option_is_one_line_exit_code_2_and_no_output(
    source: Path, tokens: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration = () if "--calibration" in tokens else ("--calibration", source / "rig.toml")
    before = sorted(source.iterdir())
    assert run("import", "openpose", source / "json", source / "rec", *calibration, *tokens) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert message in captured.err
    assert sorted(source.iterdir()) == before


def test_coco_makes_a_recording(source: Path) -> None:
    result = {"image_id": "cam1/4.jpg", "category_id": 1, "keypoints": [200.0, 300.0, 0.5] * 17}
    (source / "results.json").write_text(json.dumps([result]))
    assert run("import", "coco", source / "results.json", source / "rec", "--calibration",
                source / "rig.toml", "--fps", 30) == 0  # fmt: skip
    recording = load_recording(source / "rec")
    assert [len(series.scores) for series in recording.views] == [1, 0]


@needs_shared
@pytest.mark.shared
def test_shelf_and_panoptic_survive_the_folder(tmp_path: Path) -> None:
    data = Path(str(SHARED)) / "data"
    assert run("import", "shelf", data / "shelf/shelf.npz", tmp_path / "shelf") == 0
    shelf = load_recording(tmp_path / "shelf")
    assert (shelf.num_slots, shelf.truth_complete) == (301, False)
    assert run("import", "panoptic", data / "panoptic/160906_band1.npz", tmp_path / "band",
                "--cameras", "3, 00_06", "--project-truth") == 0  # fmt: skip
    band = load_recording(tmp_path / "band")
    assert band.rig.camera_ids == ("00_03", "00_06")
    assert band.truth_complete
