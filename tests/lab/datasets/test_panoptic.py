from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.recording import Recording
from e3pose.recording.problems import find_problems
from e3pose_lab.datasets.panoptic import import_panoptic

# A camera 3 m from the middle, 1.5 m high, that looks along world y: in Panoptic's axes (x right, y
# down, z away) it needs no rotation, only the shift of its centre (0, -150, -300) cm.
K = [[1400.0, 0, 960], [0, 1400, 540], [0, 0, 1]]
DIST = [-0.2, 0.1, 0.001, -0.001, 0.02]
NAMES = ["00_03", "00_06"]
T_CM = [[0.0, 150.0, 300.0], [-100.0, 150.0, 300.0]]
HEAD_CM = [20.0, -170.0, 50.0]  # 1.7 m above the floor


def _bodies() -> Any:
    """Frames 10, 11 and 13 of persons 0 and 4; person 4's wrist is a guess, frame 13 lacks her."""
    bodies = np.full((3, 2, 19, 4), -1.0)
    bodies[:2] = [*HEAD_CM, 0.9]
    bodies[2, 0] = [*HEAD_CM, 0.9]
    bodies[:2, 1, :, 0] += 60
    bodies[0, 1, 5, 3] = 0.1
    return bodies


def _save_npz(path: Path, **change: Any) -> Path:
    arrays: dict[str, Any] = {
        "cam_names": np.array(NAMES),
        "K": np.array([K, K]),
        "dist": np.array([DIST, DIST]),
        "R": np.array([np.eye(3)] * 2),
        "t_cm": np.array(T_CM),
        "resolution": np.array([1920, 1080]),
        "frames": np.array([10, 11, 13]),
        "ids": np.array([0, 4]),
        "joints19_cm_conf": _bodies(),
    } | change
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return path


def _save_folder(path: Path) -> Path:
    cameras = [
        {"name": name, "type": "hd", "resolution": [1920, 1080], "panel": 0, "node": int(name[3:]),
         "K": K, "distCoef": DIST, "R": np.eye(3).tolist(), "t": [[v] for v in t_cm]}
        for name, t_cm in zip(NAMES, T_CM, strict=True)
    ]  # fmt: skip
    truth = path / "hdPose3d_stage1_coco19"
    truth.mkdir(parents=True)
    (path / "calibration_test.json").write_text(json.dumps({"cameras": cameras}))
    for frame, people in zip((10, 11, 13), _bodies(), strict=True):
        bodies = [
            {"id": person, "joints19": body.ravel().tolist()}
            for person, body in zip((0, 4), people, strict=True)
            if body[0, 3] > 0
        ]
        scene = {"version": 0.7, "univTime": 0.0, "fpsType": "hd_29_97", "bodies": bodies}
        (truth / f"body3DScene_{frame:08d}.json").write_text(json.dumps(scene))
    return path


def _load(source: Path, **options: Any) -> Recording:
    return import_panoptic(source, cameras=["3", "00_06"], **options)


@each_case("kind", ["npz", "folder"])
def test_truth_is_in_metres_with_z_up_before_the_same_cameras(tmp_path: Path, kind: str) -> None:
    source = _save_npz(tmp_path / "p.npz") if kind == "npz" else _save_folder(tmp_path / "p")
    recording = _load(source)
    assert recording.truth is not None
    assert (recording.num_slots, recording.fps) == (4, 29.97)
    assert recording.truth.person_ids == ("person0", "person4")
    people = np.any(recording.truth.annotated, axis=2).tolist()
    assert people == [[True, True], [True, True], [False, False], [True, False]]
    np.testing.assert_allclose(recording.truth.joints_m[0, 0, 0], [0.2, 0.5, 1.7], atol=1e-9)
    assert np.isnan(recording.truth.joints_m[0, 1, 5]).all()
    assert not np.isnan(recording.truth.joints_m[1, 1, 5]).any()
    assert all(len(series.slots) == 0 for series in recording.views)
    rig = recording.rig
    assert rig.camera_ids == ("00_03", "00_06")
    np.testing.assert_allclose(rig.centers_m, [[0, -3, 1.5], [1, -3, 1.5]], atol=1e-9)
    # By the published formula: x = (20, -20, 350) / 350, with Brown's distortion.
    x, y = 20 / 350, -20 / 350
    r2 = x * x + y * y
    radial = 1 + DIST[0] * r2 + DIST[1] * r2**2 + DIST[4] * r2**3
    u = x * radial + 2 * DIST[2] * x * y + DIST[3] * (r2 + 2 * x * x)
    v = y * radial + 2 * DIST[3] * x * y + DIST[2] * (r2 + 2 * y * y)
    expected = [1400 * u + 960, 1400 * v + 540]
    np.testing.assert_allclose(rig.cameras[0].project([0.2, 0.5, 1.7]), expected, atol=1e-6)


def test_projected_truth_says_so_and_is_exact(tmp_path: Path) -> None:
    recording = _load(_save_npz(tmp_path / "p.npz"), project_truth=True)
    assert "projected truth" in recording.name
    assert "NOT detections" in recording.source
    view = recording.view(0, 0)
    assert recording.truth is not None
    assert view is not None
    expected = recording.rig.cameras[0].project(recording.truth.joints_m[0])
    np.testing.assert_allclose(view.keypoints_px, expected, atol=1e-9)
    assert view.scores[1, 5] == 0
    empty = recording.view(2, 0)
    assert empty is not None
    assert len(empty) == 0


def test_detections_keep_the_frame_numbers_of_the_sequence(tmp_path: Path) -> None:
    person = {"pose_keypoints_2d": [5.0, 6.0, 0.7] * 18}
    for camera, frames in (("hd_00_03", (9, 10, 13)), ("hd_00_06", (11, 99))):
        (tmp_path / "json" / camera).mkdir(parents=True)
        for frame in frames:
            path = tmp_path / "json" / camera / f"{frame:08d}_keypoints.json"
            path.write_text(json.dumps({"people": [person]}))
    recording = _load(_save_npz(tmp_path / "p.npz"), detections=tmp_path / "json")
    assert recording.skeleton.name == "coco18"
    assert recording.views[0].slots.tolist() == [0, 3]
    assert recording.views[1].slots.tolist() == [1]


@each_case(
    ("change", "message"),
    [
        ({"K": None}, "array 'K' is missing"),
        ({"cam_names": np.array(["../x", "00_06"])}, "'3' is not in the rig, which has 00_06"),
        ({"frames": np.array([1, 1, 2])}, "'frames': found a number twice"),
        ({"frames": np.array([1, 2, 2**30])}, "frames 1 to 1073741824"),
        ({"joints19_cm_conf": None}, "'joints19_cm_conf' is missing"),
        ({"t_cm": np.full((2, 3), np.inf)}, "'t_cm': found a value"),
        ({"t_cm": np.full((2, 3), 3e5)}, "m from the origin"),
        ({"ids": np.array([0, -4])}, "'ids': found -4"),
    ],
)
def test_a_wrong_array_is_named(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        _load(_save_npz(tmp_path / "p.npz", **change))


@each_case(
    ("content", "message"),
    [
        ("", "an empty file"),
        ('{"bodies": [{"id"', "truncated"),
        ('{"bodies": [{"id": 0, "joints19": [1, 2]}]}', r"bodies\[0\].joints19: found 2 numbers"),
        ('{"bodies": [{"id": -1, "joints19": []}]}', "joints19: found 0"),
        (json.dumps({"bodies": [{"id": -1, "joints19": [0.0] * 76}]}), "id: found -1"),
        (json.dumps({"bodies": [{"id": 0, "joints19": [1e9] * 76}]}), "beyond 1 km"),
    ],
)
def test_a_wrong_scene_is_named(tmp_path: Path, content: str, message: str) -> None:
    source = _save_folder(tmp_path / "p")
    (source / "hdPose3d_stage1_coco19" / "body3DScene_00000011.json").write_text(content)
    with pytest.raises(InputError, match=rf"body3DScene_00000011\.json: .*{message}"):
        _load(source)


def test_a_folder_without_truth_or_calibration_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"found 0 files calibration_\*\.json"):
        _load(tmp_path)
    source = _save_folder(tmp_path / "p")
    for path in (source / "hdPose3d_stage1_coco19").iterdir():
        path.unlink()
    with pytest.raises(InputError, match=r"no body3DScene_\*\.json"):
        _load(source)


def test_detections_and_projected_truth_exclude_each_other(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="only one of them"):
        _load(_save_npz(tmp_path / "p.npz"), detections=tmp_path, project_truth=True)


@pytest.mark.shared
def test_the_band_stands_on_the_floor_in_front_of_the_papers_cameras(shared: Path) -> None:
    recording = import_panoptic(shared / "data/panoptic/160906_band1.npz", project_truth=True)
    assert recording.rig.camera_ids == ("00_03", "00_06", "00_12", "00_13", "00_23")
    assert recording.truth is not None
    heights_m = recording.truth.joints_m[..., 2]
    assert 0 < np.nanmin(heights_m) < 0.2
    assert 1.0 < np.nanmax(heights_m) < 2.1
    assert [len(series.scores) for series in recording.views] == [60] * 5
    assert {problem.kind for problem in find_problems(recording)} == {"flat-scores"}


@pytest.mark.shared
def test_a_sequence_without_calibration_takes_one(shared: Path) -> None:
    folder = shared / "data/panoptic"
    source = folder / "171026_pose3_train.npz"
    with pytest.raises(InputError, match="'cam_names' is missing"):
        import_panoptic(source)
    recording = import_panoptic(source, calibration=folder / "demo_calibration.npz")
    assert (recording.num_slots, len(recording.rig)) == (5000, 5)


def test_a_joint_at_exactly_the_origin_was_not_found(tmp_path: Path) -> None:
    joints = np.full((3, 19, 3), -50.0)
    joints[1, 5] = 0.0
    source = _save_npz(tmp_path / "p.npz", joints19_cm_conf=None, ids=None, joints19_cm=joints)
    truth = _load(source).truth
    assert truth is not None
    known = np.ones((4, 1, 19), dtype=bool)
    known[2] = False  # there is no frame 12
    known[1, 0, 5] = False
    np.testing.assert_array_equal(truth.annotated, known)
