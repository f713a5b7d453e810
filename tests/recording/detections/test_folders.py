from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.recording.detections.openpose import match_folders


def _source(tmp_path: Path, *names: str) -> Path:
    for name in names:
        (tmp_path / name).mkdir()
        (tmp_path / name / "0_keypoints.json").touch()
    return tmp_path


@each_case(
    ("folders", "camera_ids", "expected"),
    [
        (["a", "b"], ["b", "a"], {"a": "a", "b": "b"}),
        (["cam01_json", "cam02_json"], ["cam01", "cam02"], {"cam01": "cam01_json"}),
        (["Cam1-keypoints", "cam10"], ["cam1", "cam10"], {"cam1": "Cam1-keypoints"}),
        (["cam1_json", "cam11_json"], ["int_cam1_img", "cam11"], {"cam11": "cam11_json"}),
        (["walk_left", "walk_right"], ["left", "right"], {"left": "walk_left"}),
        (["1_json", "11_json"], ["cam_1", "cam_11"], {"cam_1": "1_json", "cam_11": "11_json"}),
        (["hd_00_03", "hd_00_13"], ["00_03", "00_13"], {"00_03": "hd_00_03"}),
    ],
)
def test_usual_names_find_their_camera(
    tmp_path: Path, folders: list[str], camera_ids: list[str], expected: Mapping[str, str]
) -> None:
    if "int_cam1_img" in camera_ids:
        with pytest.raises(InputError, match="folders without a camera: "):
            match_folders(_source(tmp_path, *folders), camera_ids, {})
        return
    matched = match_folders(_source(tmp_path, *folders), camera_ids, {})
    assert sorted(matched) == sorted(camera_ids)
    assert sorted(path.name for path in matched.values()) == sorted(folders)
    for camera_id, name in expected.items():
        assert matched[camera_id].name == name


def test_cam1_never_claims_cam10(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="without a folder: cam1; folders without a camera: cam10"):
        match_folders(_source(tmp_path, "cam10"), ["cam1"], {})


def test_what_is_left_over_is_listed_on_both_sides(tmp_path: Path) -> None:
    source = _source(tmp_path, "a", "x", "y")
    with pytest.raises(InputError, match="folder: b; folders without a camera: x, y;"):
        match_folders(source, ["a", "b"], {})


def test_a_given_folder_goes_before_any_guess(tmp_path: Path) -> None:
    source = _source(tmp_path, "a", "b")
    matched = match_folders(source, ["a", "b"], {"a": "b", "b": "a"})
    assert {camera_id: path.name for camera_id, path in matched.items()} == {"a": "b", "b": "a"}


@each_case(
    ("given", "message"),
    [
        ({"eve": "a"}, "camera 'eve' is not one of a, b"),
        ({"a": "../a"}, "'../a' is not a folder of JSON files"),
        ({"a": "b", "b": "b"}, "one folder for two cameras"),
    ],
)
def test_a_wrong_pair_is_named(tmp_path: Path, given: Mapping[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        match_folders(_source(tmp_path, "a", "b"), ["a", "b"], given)


def test_folders_without_json_do_not_count(tmp_path: Path) -> None:
    source = _source(tmp_path, "a")
    (source / "calibration").mkdir()
    assert list(match_folders(source, ["a"], {})) == ["a"]


def test_a_missing_source_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="found nothing, expected a folder"):
        match_folders(tmp_path / "absent", ["a"], {})
