from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.recording.pairing import name_videos, pair_names, pair_videos
from e3pose.recording.videos import chapters_of


def rig(*camera_ids: str) -> Rig:
    K = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    return Rig(tuple(Camera(name, (64, 48), K, np.eye(4)) for name in camera_ids))


@each_case(
    ("camera_ids", "videos", "stems"),
    [
        (["cam1", "cam2"], ["b/cam2.mp4", "a/cam1.mkv"], ["cam1", "cam2"]),
        (["Cam1", "Cam2"], ["CAM2.mp4", "cam1.mp4"], ["cam1", "CAM2"]),
        (["cam1", "cam10"], ["walk_cam10.mp4", "walk_cam1.mp4"], ["walk_cam1", "walk_cam10"]),
        (["int_cam01_img", "int_cam02_img"], ["cam01.mp4"], ["cam01"]),
        (["cam_01", "cam_02"], ["GX2.mp4", "GX1.mp4"], ["GX1", "GX2"]),
        (["left", "right"], ["right=x.mp4", "left=y.mp4"], ["y", "x"]),
        (["left", "right"], ["right=x.mp4", "left.mp4"], ["left", "x"]),
        (["a", "b", "c"], ["c.mp4", "a.mp4"], ["a", "c"]),
        (["Kuche", "Cam_1"], ["Cam 1.mp4", "Küche.mp4"], ["Küche", "Cam 1"]),
        (["Kuche", "Cam_1"], ["Cam 1=a.mp4", "Küche=b.mp4"], ["b", "a"]),
    ],
)
def test_pairs_by_name(camera_ids: Sequence[str], videos: list[str], stems: list[str]) -> None:
    pairs = pair_videos(videos, rig(*camera_ids))
    assert [path.stem for path in pairs.values()] == stems
    order = [camera_id for camera_id in camera_ids if camera_id in pairs]
    assert list(pairs) == order


@each_case(
    "videos",
    [
        ["x.mp4", "y.mp4"],
        ["cam1.mp4", "a/cam1.mp4"],
        ["cam1.mp4", "cam2.mp4", "cam3.mp4"],
        ["cam1_cam2.mp4"],
        ["cam1=x.mp4", "cam1.mp4"],
    ],
)
def test_doubt_is_an_error_that_lists_both_sides(videos: list[str]) -> None:
    with pytest.raises(InputError, match="cannot tell which camera") as caught:
        pair_videos(videos, rig("cam1", "cam2"))
    text = str(caught.value)
    assert "cam2" in text and Path(videos[-1]).name in text


def test_wrong_camera_is_named() -> None:
    with pytest.raises(InputError, match="'cam9', which is not in the rig"):
        pair_videos(["cam9=x.mp4"], rig("cam1"))
    with pytest.raises(InputError, match="found none"):
        pair_videos([], rig("cam1"))


def test_camera_again_is_its_next_chapter(tmp_path: Path) -> None:
    first, second = tmp_path / "GX01.MP4", tmp_path / "GX02.MP4"
    first.touch()
    second.touch()
    paired = pair_videos([f"cam1={first}", f"cam1={second}"], rig("cam1"))
    assert chapters_of(paired["cam1"]) == [first, second]
    assert name_videos([f"cam1={first}", f"cam1={second}"]) == paired
    assert list(name_videos([f"{first}+{second.name}"])) == ["GX01"]


def test_file_with_an_equals_sign_in_its_name_is_a_file(tmp_path: Path) -> None:
    file = tmp_path / "take=3_cam1.mp4"
    file.touch()
    assert pair_videos([str(file)], rig("cam1", "cam2")) == {"cam1": file}


@each_case(
    ("names", "camera_ids", "expected", "left"),
    [
        (["a", "b"], ["b", "a"], {"a": "a", "b": "b"}, []),
        (["cam01_json", "cam02_json"], ["cam01", "cam02"], {"cam01": "cam01_json"}, []),
        (["Cam1-keypoints", "cam10"], ["cam1", "cam10"], {"cam1": "Cam1-keypoints"}, []),
        (["walk_left", "walk_right"], ["left", "right"], {"left": "walk_left"}, []),
        (["1_json", "11_json"], ["cam_1", "cam_11"], {"cam_1": "1_json", "cam_11": "11_json"}, []),
        (["hd_00_03", "hd_00_13"], ["00_03", "00_13"], {"00_03": "hd_00_03"}, []),
        (["cam0.json", "cam1.json", "all.json"], ["cam0", "cam1"], {"cam1": "cam1.json"},
         ["all.json"]),
        (["cam1"], ["cam1", "cam2"], {"cam1": "cam1"}, []),
    ],
)  # fmt: skip
def test_folders_and_files_find_their_camera(
    names: list[str], camera_ids: list[str], expected: dict[str, str], left: list[str]
) -> None:
    paired, unpaired = pair_names(Path("json"), names, camera_ids, {})
    assert {camera_id: paired[camera_id] for camera_id in expected} == expected
    assert unpaired == left and len(paired) == len(names) - len(left)
    swapped = dict(zip(camera_ids, reversed(names[:2]), strict=False))
    if len(names) == len(camera_ids) == 2:
        assert pair_names(Path("json"), names, camera_ids, swapped) == (swapped, [])


@each_case(
    ("names", "given", "message"),
    [
        (["cam10"], {}, "without a folder: cam1, b; of no camera: cam10"),
        (["cam1", "x"], {}, "without a folder: b; of no camera: x"),
        (["cam1", "b"], {"eve": "cam1"}, "camera 'eve' is not one of cam1, b"),
        (["cam1", "b"], {"cam1": "../a"}, "'../a' holds no detections"),
        (["cam1", "b"], {"cam1": "b", "b": "b"}, "one folder for two cameras"),
    ],
)
def test_folders_and_cameras_left_over_are_listed(
    names: list[str], given: dict[str, str], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        pair_names(Path("json"), names, ["cam1", "b"], given)
