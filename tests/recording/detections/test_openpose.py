from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.recording.calibration import save_rig
from e3pose.recording.detections.openpose import frame_number, import_openpose

K = [[900, 0, 640], [0, 900, 360], [0, 0, 1]]


def _rig(*camera_ids: str) -> Rig:
    return Rig(
        tuple(
            Camera.from_world_to_camera(name, (1280, 720), K, np.eye(3), [0.5 * n, 0, 3])
            for n, name in enumerate(camera_ids)
        )
    )


def _person(count: int, x: float) -> dict[str, Any]:
    """Joint j lies at (x + j, 100 + j) with score 0.9, joint 3 is missing."""
    triples = [[x + j, 100.0 + j, 0.9] for j in range(count)]
    triples[3] = [0.0, 0.0, 0.0]
    return {
        "person_id": [-1],
        "pose_keypoints_2d": np.ravel(triples).tolist(),
        "face_keypoints_2d": [],
    }


def _write(source: Path, folder: str, file: str, content: Any) -> Path:
    (source / folder).mkdir(parents=True, exist_ok=True)
    path = source / folder / file
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    save_rig(_rig("cam1", "cam2"), tmp_path / "rig.toml")
    return tmp_path / "rig.toml"


@each_case(("count", "skeleton"), [(25, "body25"), (18, "coco18"), (17, "coco17")])
def test_people_land_in_their_camera_and_slot(
    tmp_path: Path, calibration: Path, count: int, skeleton: str
) -> None:
    source = tmp_path / "json"
    people = [_person(count, 10.0), _person(count, 500.0)]
    _write(source, "cam1_json", "walk2_000000000005_keypoints.json", {"people": people[:1]})
    _write(source, "cam1_json", "walk2_000000000007_keypoints.json", {"people": people})
    _write(source, "cam2_json", "walk2_000000000006_keypoints.json", {"people": []})
    recording = import_openpose(source, calibration, fps=50.0)
    assert recording.skeleton.name == skeleton
    assert (recording.num_slots, recording.fps) == (3, 50.0)
    present = [[recording.view(slot, camera) is not None for slot in range(3)] for camera in (0, 1)]
    assert present == [[True, False, True], [False, True, False]]
    view = recording.view(2, 0)
    assert view is not None
    assert len(view) == 2
    assert view.keypoints_px[1, 4].tolist() == [504.0, 104.0]
    assert view.scores[1, 4] == 0.9
    assert np.isnan(view.keypoints_px[1, 3]).all()
    assert view.scores[1, 3] == 0
    empty = recording.view(1, 1)
    assert empty is not None
    assert len(empty) == 0
    np.testing.assert_allclose(recording.views[0].times_s, [0, 0.04])


def test_a_score_just_above_one_is_clipped(tmp_path: Path, calibration: Path) -> None:
    person = _person(25, 10.0)
    person["pose_keypoints_2d"][2] = 1.04
    _write(tmp_path / "json", "cam1", "0_keypoints.json", {"people": [person]})
    _write(tmp_path / "json", "cam2", "0_keypoints.json", {"people": []})
    view = import_openpose(tmp_path / "json", calibration, 25).view(0, 0)
    assert view is not None
    assert view.scores[0, 0] == 1.0


def _changed(index: int, value: object) -> dict[str, Any]:
    person = _person(25, 10.0)
    person["pose_keypoints_2d"][index] = value
    return {"people": [person]}


@each_case(
    ("content", "message"),
    [
        ("", "an empty file, expected OpenPose JSON"),
        ('{"people": [{"pose_keypoi', "truncated"),
        ("[]", "Expected `object`"),
        ("{}", "missing required field `people`"),
        ({"people": [{"pose_keypoints": []}]}, "missing required field `pose_keypoints_2d`"),
        ({"people": [{"pose_keypoints_2d": [1.0] * 60}]}, r"people\[0\].*found 60 numbers"),
        (_changed(2, 7.5), "score: found 7.5, expected 0 to 1"),
        (_changed(0, 1e9), r"coordinate beyond 1e\+06 px"),
        (_changed(0, "left"), "got `str`"),
        (_changed(0, None), "got `null`"),
        ('{"people": NaN}', "malformed"),
        ('{"x": ' + "[" * 200_000, "expected OpenPose JSON"),
        ({"people": [{"pose_keypoints_2d": [1.0] * 51}]}, "found 75 numbers, expected 51"),
    ],
)
def test_a_broken_file_is_named_with_its_field(
    tmp_path: Path, calibration: Path, content: Any, message: str
) -> None:
    _write(tmp_path / "json", "cam1", "0_keypoints.json", content)
    _write(tmp_path / "json", "cam2", "0_keypoints.json", {"people": [_person(25, 3.0)]})
    with pytest.raises(InputError, match=rf"cam[12]/0_keypoints\.json: .*{message}") as caught:
        import_openpose(tmp_path / "json", calibration, 25)
    assert "\n" not in str(caught.value)


@each_case(
    ("names", "message"),
    [
        (["a_keypoints.json"], "no frame number"),
        (["1_keypoints.json", "01_keypoints.json"], "frame number 1 appears twice"),
        (["1_keypoints.json", "99999999999_keypoints.json"], "frame numbers: found 1 to 999999"),
    ],
)
def test_frame_numbers_are_checked(
    tmp_path: Path, calibration: Path, names: list[str], message: str
) -> None:
    _write(tmp_path / "json", "cam2", "1_keypoints.json", {"people": []})
    for name in names:
        _write(tmp_path / "json", "cam1", name, {"people": [_person(25, 3.0)]})
    with pytest.raises(InputError, match=message):
        import_openpose(tmp_path / "json", calibration, 25)


def test_shares_of_the_image_are_not_taken_for_pixels(tmp_path: Path, calibration: Path) -> None:
    person = {"pose_keypoints_2d": [0.4, 0.6, 0.9] * 25}
    for camera in ("cam1", "cam2"):
        _write(tmp_path / "json", camera, "0_keypoints.json", {"people": [person]})
    with pytest.raises(InputError, match="expected pixels, not shares of the image"):
        import_openpose(tmp_path / "json", calibration, 25)


def test_a_recording_with_nobody_is_refused(tmp_path: Path, calibration: Path) -> None:
    for camera in ("cam1", "cam2"):
        _write(tmp_path / "json", camera, "0_keypoints.json", {"people": []})
    with pytest.raises(InputError, match="found nobody in 2 files"):
        import_openpose(tmp_path / "json", calibration, 25)


@each_case("fps", [0.0, -1.0, float("nan"), float("inf"), 1e6])
def test_a_wrong_frame_rate_is_named(tmp_path: Path, calibration: Path, fps: float) -> None:
    with pytest.raises(InputError, match="--fps"):
        import_openpose(tmp_path, calibration, fps)


@each_case(
    ("name", "number"),
    [
        ("000000000012_keypoints.json", 12),
        ("cam2_walk3_000017_keypoints.json", 17),
        ("cam01.0007.json", 7),
        ("12.json", 12),
    ],
)
def test_the_last_number_of_a_name_is_the_frame(name: str, number: int) -> None:
    assert frame_number(name) == number


def test_a_long_file_name_takes_no_time() -> None:
    with pytest.raises(InputError, match="no frame number"):
        frame_number("1" * 1_000_000)
