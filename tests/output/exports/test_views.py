"""OpenPose and COCO JSON, read back by the importers, and rerun's recordings by rerun."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tests.estimate.filter.room import RIG
from tests.output.exports.takes import MISSING_FRAMES, take

from e3pose.base.errors import InputError
from e3pose.model.skeleton import BODY25, COCO17, convert
from e3pose.output.exports import ExportSettings, export
from e3pose.recording.calibration import save_rig
from e3pose.recording.detections.importing import ImportSettings, import_detections

TAKE = take()
FIRST, SECOND = TAKE.motions
CAMERAS = ExportSettings(rig=RIG)


def test_openpose_without_cameras_is_3d(tmp_path: Path) -> None:
    ((path, summary),) = export(TAKE, tmp_path / "op", "openpose")
    assert "40 frames, 3D" in summary
    files = sorted(path.iterdir())
    assert [file.name for file in files][::39] == [
        "000000000000_keypoints.json",
        "000000000039_keypoints.json",
    ]
    assert len(json.loads(files[5].read_text())["people"]) == 1  # the second one comes later
    people = json.loads(files[12].read_text())["people"]
    assert [person["person_id"] for person in people] == [[3], [7]]
    assert people[0]["pose_keypoints_2d"] == []
    points = np.array(people[1]["pose_keypoints_3d"]).reshape(25, 4)
    wanted, _ = convert(SECOND.joints_m[6:7], SECOND.scores[6:7], COCO17, BODY25)
    known = np.isfinite(wanted[0]).all(axis=-1)
    assert 1000 * np.abs(points[known, :3] - wanted[0][known]).max() < 0.01
    assert (points[~known] == 0).all() and (points[known, 3] == 0.8).all()
    wrist = np.array(people[0]["pose_keypoints_3d"]).reshape(25, 4)[BODY25.index("left_wrist")]
    assert (wrist == 0).all()


def test_openpose_of_cameras_can_be_imported(tmp_path: Path) -> None:
    ((path, _),) = export(TAKE, tmp_path / "op", "openpose", CAMERAS)
    save_rig(RIG, tmp_path / "rig.toml")
    recording, _ = import_detections(path, tmp_path / "rig.toml", 25.0)
    assert recording.num_slots == 40 and recording.skeleton == BODY25
    for camera in range(len(RIG)):
        view = recording.view(12, camera)
        assert view is not None and len(view) == 2
        wanted = RIG.cameras[camera].project(FIRST.joints_m[12, COCO17.index("right_knee")])
        found = view.keypoints_px[:, BODY25.index("right_knee")]
        assert np.linalg.norm(found - wanted, axis=1).min() < 0.001
    with pytest.raises(InputError, match="not empty"):
        list(export(TAKE, path, "openpose"))


def test_coco_needs_cameras_and_can_be_imported(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--calibration"):
        list(export(TAKE, tmp_path / "coco.json", "coco"))
    ((path, summary),) = export(TAKE, tmp_path / "coco.json", "coco", CAMERAS)
    assert summary.startswith("200 images of 5 cameras")
    document = json.loads(path.read_text())
    assert [image["id"] for image in document["images"]] == [*range(1, 201)]
    (category,) = document["categories"]
    assert tuple(category["keypoints"]) == COCO17.joints
    names = {image["id"]: image["file_name"] for image in document["images"]}
    for one in document["annotations"]:
        points = np.array(one["keypoints"]).reshape(17, 3)
        assert one["num_keypoints"] == (points[:, 2] > 0).sum()
        frame = int(Path(names[one["image_id"]]).stem)
        motion = FIRST if one["track_id"] == 3 else SECOND
        predicted = 20 <= frame - motion.first < 25
        assert set(points[:, 2]) <= ({0, 1} if predicted else {0, 2})
        low = points[points[:, 2] > 0, :2].min(axis=0)
        np.testing.assert_allclose(one["bbox"][:2], low, atol=0.002)
    save_rig(RIG, tmp_path / "rig.toml")
    results = [{**one, "keypoints": _scored(one)} for one in document["annotations"]]
    (tmp_path / "results.json").write_text(json.dumps(results))
    settings = ImportSettings(images=path)
    recording, _ = import_detections(
        tmp_path / "results.json", tmp_path / "rig.toml", 25.0, settings
    )
    view = recording.view(MISSING_FRAMES.start, 2)
    assert view is not None and len(view) == 2
    wanted = RIG.cameras[2].project(SECOND.joints_m[MISSING_FRAMES.start - 6, 14])
    assert np.linalg.norm(view.keypoints_px[:, 14] - wanted, axis=1).min() < 0.002


def _scored(annotation: dict[str, list[float]]) -> list[float]:
    points = np.array(annotation["keypoints"]).reshape(17, 3)
    points[:, 2] = annotation["scores"]
    numbers: list[float] = points.ravel().tolist()
    return numbers


def test_rerun_reads_what_was_written(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="the extra rerun is not installed")
    ((path, _),) = export(TAKE, tmp_path / "walk.rrd", "rerun")
    assert path.read_bytes()[:3] == b"RRF"
    chunk = pytest.importorskip("rerun.chunk", reason="this rerun reads no files")
    found: dict[int, list[list[float]]] = {}
    for part in chunk.RrdReader(str(path)).stream():
        if part.entity_path == "/world/track7/joints":
            rows = part.to_record_batch().to_pydict()
            found |= dict(zip(rows["slot"], rows["Points3D:positions"], strict=True))
    assert sorted(found) == [*range(6, 40)]
    assert 1000 * np.abs(np.array(found[11]) - SECOND.joints_m[5]).max() < 0.01
