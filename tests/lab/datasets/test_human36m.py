"""Human3.6M's JSON annotations, on a tiny folder made here."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.model.pose import Poses2D
from e3pose.model.rigs import ring_rig
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording, ViewSeries, save_recording
from e3pose_lab.datasets.human36m import import_human36m

RIG = ring_rig(4, 5.0, 1.6, (1000, 1000), np.random.default_rng(0))
FRAMES = 6
NOSE, LEFT_WRIST = 9, 13


def joints_mm() -> np.ndarray:
    """`(frames, 17, 3)` of somebody in the middle, joints in a column, who moves along x."""
    joints = np.zeros((FRAMES, 17, 3))
    joints[..., 0] = 20.0 * np.arange(FRAMES)[:, None]
    joints[..., 2] = 200.0 + 80.0 * np.arange(17)
    return joints


def publish(folder: Path, placed: bool = False) -> Path:
    """Write the annotations of subject 9, action 14; `placed` cameras say where they are."""
    annotations = folder / "annotations"
    annotations.mkdir(parents=True)
    cameras = {
        str(number): {
            "R": camera.R.tolist(),
            "t": (1000 * (camera.center_m if placed else -camera.R @ camera.center_m)).tolist(),
            "f": [camera.K[0, 0], camera.K[1, 1]],
            "c": [camera.K[0, 2], camera.K[1, 2]],
        }
        for number, camera in enumerate(RIG.cameras, 1)
    }
    frames = {str(number): joints.tolist() for number, joints in enumerate(joints_mm())}
    del frames["3"]
    write(annotations, "camera", cameras)
    write(annotations, "joint_3d", {"14": {"1": frames}})
    return folder


def write(annotations: Path, part: str, content: object) -> None:
    (annotations / f"Human36M_subject9_{part}.json").write_text(json.dumps(content))


@pytest.mark.parametrize("placed", [False, True])
def test_cameras_and_joints_are_read_in_metres(tmp_path: Path, placed: bool) -> None:
    recording = import_human36m(publish(tmp_path / "h36m", placed), 9, 14)
    assert recording.num_slots == FRAMES and recording.fps == 50.0
    assert recording.rig.camera_ids == ("ca_01", "ca_02", "ca_03", "ca_04")
    for found, true in zip(recording.rig.cameras, RIG.cameras, strict=True):
        assert found.center_m == pytest.approx(true.center_m, abs=1e-9)
        assert pytest.approx(true.K, abs=1e-9) == found.K
    assert [camera.image_size[1] for camera in recording.rig.cameras] == [1002, 1000, 1000, 1002]
    assert recording.truth is not None and recording.truth.person_ids == ("S9",)
    joints_m, wanted_m = recording.truth.joints_m[:, 0], joints_mm() / 1000
    assert joints_m[5, COCO17.index("nose")] == pytest.approx(wanted_m[5, NOSE])
    assert joints_m[5, COCO17.index("left_wrist")] == pytest.approx(wanted_m[5, LEFT_WRIST])
    assert np.isnan(joints_m[3]).all() and np.isnan(joints_m[5, COCO17.index("left_ear")]).all()
    assert not any(len(series.slots) for series in recording.views)


def test_what_was_detected_on_the_images_joins_by_their_numbers(tmp_path: Path) -> None:
    source = publish(tmp_path / "h36m")
    rig = import_human36m(source, 9, 14).rig
    frames = [Poses2D(np.full((1, 17, 2), 10.0 + s), np.ones((1, 17))) for s in range(FRAMES)]
    series = ViewSeries.from_views(frames, range(FRAMES), [s / 50 for s in range(FRAMES)], 17)
    found = Recording("found", rig, 50.0, FRAMES, COCO17, (series,) * 4, detector="openpose-thin")
    save_recording(found, tmp_path / "found")
    recording = import_human36m(source, 9, 14, detections=tmp_path / "found")
    view = recording.view(2, 1)
    assert view is not None and view.keypoints_px[0, 0, 0] == 12.0
    assert recording.detector == "openpose-thin"


@pytest.mark.parametrize("part", ["camera", "joint_3d"])
def test_a_missing_part_is_named_with_its_place(tmp_path: Path, part: str) -> None:
    source = publish(tmp_path / "h36m")
    (source / "annotations" / f"Human36M_subject9_{part}.json").unlink()
    with pytest.raises(InputError, match=rf"{part}\.json: missing: .*vision\.imar\.ro"):
        import_human36m(source, 9, 14)


@each_case(
    ("part", "content", "said"),
    [
        ("camera", {}, "found 0 cameras"),
        ("camera", {"1": {"R": [[1.0]], "t": [0.0], "f": [1.0], "c": [1.0]}}, "other shapes"),
        ("camera", [], "expected Human3.6M's JSON"),
        ("joint_3d", {"14": {"1": {}}}, "found 0 frames"),
        ("joint_3d", {"14": {"1": {"-1": [[0.0] * 3] * 17}}}, "expected numbers from 0"),
        ("joint_3d", {"14": {"1": {"0": [[0.0] * 3] * 16}}}, "found 16 joints"),
        ("joint_3d", {"14": {"1": {"0": [[1e9] * 3] * 17}}}, "beyond"),
    ],
)
def test_broken_annotations_are_named(
    tmp_path: Path, part: str, content: object, said: str
) -> None:
    source = publish(tmp_path / "h36m")
    write(source / "annotations", part, content)
    with pytest.raises(InputError, match=said):
        import_human36m(source, 9, 14)


def test_cameras_that_see_nobody_are_refused(tmp_path: Path) -> None:
    source = publish(tmp_path / "h36m")
    path = source / "annotations" / "Human36M_subject9_camera.json"
    cameras = json.loads(path.read_text())
    for camera in cameras.values():
        camera["t"] = [value / 1000 for value in camera["t"]]  # in metres
    path.write_text(json.dumps(cameras))
    with pytest.raises(InputError, match="expected those of the subject, in mm"):
        import_human36m(source, 9, 14)


def test_sequences_that_are_not_there_are_refused(tmp_path: Path) -> None:
    source = publish(tmp_path / "h36m")
    with pytest.raises(InputError, match="--action: found 3, expected one of 14"):
        import_human36m(source, 9, 3)
    with pytest.raises(InputError, match="--subaction: found 2, expected one of 1"):
        import_human36m(source, 9, 14, 2)
