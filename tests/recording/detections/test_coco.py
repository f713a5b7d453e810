from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.recording import Recording
from e3pose.recording.calibration import save_rig
from e3pose.recording.detections.coco import import_coco

K = [[900, 0, 640], [0, 900, 360], [0, 0, 1]]


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    cameras = tuple(
        Camera.from_world_to_camera(name, (1280, 720), K, np.eye(3), [0.5 * n, 0, 3])
        for n, name in enumerate(("left", "right"))
    )
    save_rig(Rig(cameras), tmp_path / "rig.toml")
    return tmp_path / "rig.toml"


def _result(image_id: int | str, x: float, **more: Any) -> dict[str, Any]:
    keypoints = [value for j in range(17) for value in (x + j, 50.0 + j, 0.8)]
    return {"image_id": image_id, "category_id": 1, "keypoints": keypoints, "score": 2.9, **more}


def _write(path: Path, content: Any) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def _counts(recording: Recording) -> list[list[int | None]]:
    views = [
        [recording.view(slot, camera) for slot in range(recording.num_slots)]
        for camera in range(len(recording.rig))
    ]
    return [[None if view is None else len(view) for view in row] for row in views]


IMAGES = {
    "images": [
        {"id": 7, "file_name": "left/0004.jpg"},
        {"id": 8, "file_name": "left/0006.jpg"},
        {"id": 9, "file_name": "data/right/0005.jpg", "width": 1280},
    ]
}


def test_a_table_of_images_tells_empty_from_lost(tmp_path: Path, calibration: Path) -> None:
    results = [_result(7, 10.0), _result(7, 300.0), _result(9, 20.0), _result(9, 5, category_id=2)]
    recording = import_coco(
        _write(tmp_path / "r.json", results), calibration, 30, _write(tmp_path / "i.json", IMAGES)
    )
    assert _counts(recording) == [[2, None, 0], [None, 1, None]]
    view = recording.view(1, 1)
    assert view is not None
    assert view.keypoints_px[0, 16].tolist() == [36.0, 66.0]


def test_a_whole_dataset_needs_no_second_file(tmp_path: Path, calibration: Path) -> None:
    source = _write(tmp_path / "r.json", {**IMAGES, "annotations": [_result(8, 10.0)]})
    assert _counts(import_coco(source, calibration, 30)) == [[0, None, 1], [None, 0, None]]


@pytest.mark.parametrize(
    ("more", "score"), [({}, 1.0), ({"scores": [0.25] * 17}, 0.25)], ids=["flags", "scores"]
)
def test_flags_of_annotations_are_no_scores(
    more: dict[str, Any], score: float, tmp_path: Path, calibration: Path
) -> None:
    annotation = _result(8, 10.0, **more)
    annotation["keypoints"][2::3] = [2, 1, 0] + [2] * 14
    source = _write(tmp_path / "r.json", {**IMAGES, "annotations": [annotation]})
    view = import_coco(source, calibration, 30).view(2, 0)
    assert view is not None
    assert view.scores[0].tolist() == pytest.approx([score, score, 0.0] + [score] * 14)


def test_names_as_image_ids_need_no_table(tmp_path: Path, calibration: Path) -> None:
    results = [_result("left/3.jpg", 10.0), _result("right\\5.png", 10.0)]
    recording = import_coco(_write(tmp_path / "r.json", results), calibration, 30)
    assert _counts(recording) == [[1, 0, 0], [0, 0, 1]]


@each_case(
    ("results", "message"),
    [
        ("", "r.json: an empty file"),
        ('[{"keypoints"', "r.json: .*truncated"),
        ("3", r"r.json: Expected `array`"),
        ([], "r.json: found no frame"),
        ([_result(3, 1.0)], r"r.json: \[0\].image_id: found '3', expected an image"),
        ([_result("middle/3.jpg", 1.0)], r"\[0\]: file name: found 'middle/3.jpg'"),
        ([_result("left/right/3.jpg", 1.0)], "file name: found 'left/right/3.jpg'"),
        ([_result("left/a.jpg", 1.0)], r"\[0\]: 'a.jpg': found no frame number"),
        ([_result("left/1.jpg", 1.0), _result("left/9999999999.jpg", 1.0)], "frame numbers"),
        ([{"image_id": "left/1.jpg", "keypoints": [1.0] * 54}], r"\[0\].keypoints: found 54"),
        ([{"image_id": "left/1.jpg"}], "missing required field `keypoints`"),
        ([{"image_id": "left/1.jpg", "keypoints": [9.0, 9.0, 5.0] * 17}], "score: found 5"),
        ("[" * 100_000, "r.json: "),
    ],
)
def test_broken_results_are_named(
    tmp_path: Path, calibration: Path, results: Any, message: str
) -> None:
    with pytest.raises(InputError, match=message) as caught:
        import_coco(_write(tmp_path / "r.json", results), calibration, 30)
    assert "\n" not in str(caught.value)


@each_case(
    ("images", "message"),
    [
        ([{"id": 7, "file_name": "left/1.jpg"}] * 2, r"i.json: images\[1\]: image 7 appears twice"),
        ([{"id": 7, "file_name": "eve/1.jpg"}], r"i.json: images\[0\]: file name"),
        ([{"id": 7}], "i.json: .*file_name"),
    ],
)
def test_a_broken_table_is_named(
    tmp_path: Path, calibration: Path, images: Any, message: str
) -> None:
    source = _write(tmp_path / "r.json", [_result(7, 1.0)])
    with pytest.raises(InputError, match=message):
        import_coco(source, calibration, 30, _write(tmp_path / "i.json", {"images": images}))


def test_an_image_that_the_table_lacks_is_named(tmp_path: Path, calibration: Path) -> None:
    source = _write(tmp_path / "r.json", [_result(70, 1.0)])
    with pytest.raises(InputError, match=r"\[0\].image_id: found '70'"):
        import_coco(source, calibration, 30, _write(tmp_path / "i.json", IMAGES))
