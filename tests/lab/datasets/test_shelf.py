from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.model.skeleton import BODY25, COCO17
from e3pose.recording.problems import find_problems, truth_distances_px
from e3pose_lab.datasets.shelf import import_shelf


def _arrays() -> dict[str, Any]:
    """Two cameras, three slots; camera 1 sees two people in slot 2, camera 0 one in slot 0."""
    rng = np.random.default_rng(2)
    detections = rng.uniform(100, 500, (3, 17, 3))
    detections[..., 2] = 0.5
    detections[0, 4] = [0, 0, 0]
    truth = np.full((3, 2, 14, 3), np.nan)
    truth[1, 0] = 1.0
    return {
        "K": np.tile([[900.0, 0, 516], [0, 900, 388], [0, 0, 1]], (2, 1, 1)),
        "R": np.tile(np.eye(3), (2, 1, 1)),
        "t": np.array([[0.0, 0, 4], [1, 0, 4]]),
        "image_size": np.array([1032, 776]),
        "det_coco17": detections.astype(np.float32),
        "det_view": np.array([1, 0, 1], dtype=np.int8),
        "det_frame": np.array([2, 0, 2], dtype=np.int16),
        "gt3d": truth,
    }


def _save(path: Path, arrays: dict[str, Any]) -> Path:
    np.savez(path, **arrays)
    return path


def test_detections_land_in_their_view(tmp_path: Path) -> None:
    arrays = _arrays()
    recording = import_shelf(_save(tmp_path / "s.npz", arrays))
    views = [[recording.view(slot, camera) for slot in range(3)] for camera in range(2)]
    assert [[v is not None and len(v) for v in row] for row in views] == [[1, 0, 0], [0, 0, 2]]
    view = views[1][2]
    assert view is not None
    assert np.isnan(view.keypoints_px[0, 4]).all()
    np.testing.assert_array_equal(view.keypoints_px[1], arrays["det_coco17"][2, :, :2])
    assert recording.rig.cameras[1].project([0.0, 0, 0]).tolist() == [516 + 900 / 4, 388]


def test_truth_names_the_papers_actors_and_is_incomplete(tmp_path: Path) -> None:
    recording = import_shelf(_save(tmp_path / "s.npz", _arrays()))
    assert recording.truth is not None
    assert recording.truth.person_ids == ("actor1", "actor2")
    assert np.any(recording.truth.annotated, axis=2).tolist() == [
        [False, False], [True, False], [False, False]]  # fmt: skip
    assert not recording.truth_complete
    assert recording.fps == 25


@each_case(
    ("change", "message"),
    [
        ({"K": None}, "array 'K' is missing, found"),
        ({"K": np.zeros((2, 3, 3))}, "camera cam0: K: "),
        ({"R": np.ones((2, 3, 3))}, "camera cam0: rotation: "),
        ({"R": np.tile(np.eye(3), (3, 1, 1))}, r"'R': found shape \(3, 3, 3\), expected \(2, 3"),
        ({"t": np.full((2, 3), np.nan)}, "array 't': found a value that is not finite"),
        ({"t": np.full((2, 3), 4000.0)}, "is the file in millimetres"),
        ({"det_coco17": np.full((3, 17, 3), np.nan)}, "'det_coco17': found a value"),
        ({"det_coco17": np.full((3, 17, 3), 9.0)}, "det_coco17: score: found 9"),
        ({"det_coco17": np.zeros((3, 25, 3))}, r"'det_coco17': found shape \(3, 25, 3\)"),
        ({"det_view": np.array([0, 1, 2])}, "'det_view': found 2, expected 0 to 1"),
        ({"det_frame": np.array([0, 1, -1])}, "'det_frame': found -1"),
        ({"det_frame": np.array([0.0, 1.0, 2.0])}, "'det_frame': found float64"),
        ({"gt3d": np.zeros((3, 2, 19, 3))}, "'gt3d': found shape"),
        ({"image_size": np.array(["a", "b"])}, "'image_size': found"),
    ],
)
def test_a_wrong_array_is_named(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    arrays = {name: value for name, value in (_arrays() | change).items() if value is not None}
    with pytest.raises(InputError, match=message) as caught:
        import_shelf(_save(tmp_path / "s.npz", arrays))
    assert str(caught.value).startswith(str(tmp_path / "s.npz"))
    assert "\n" not in str(caught.value)


@pytest.mark.shared
def test_the_published_counts_of_labelled_frames(shared: Path) -> None:
    recording = import_shelf(shared / "data/shelf/shelf.npz")
    assert recording.truth is not None
    assert recording.num_slots == 301
    labelled = np.any(recording.truth.annotated, axis=2).sum(axis=0).tolist()
    assert dict(zip(recording.truth.person_ids, labelled, strict=True)) == {
        "actor1": 279, "actor2": 37, "actor3": 161, "actor4": 33}  # fmt: skip
    assert sum(len(series.scores) for series in recording.views) == 4556
    # Published: the truth lies 12.6 px (median over joints) from the detections.
    assert np.median(truth_distances_px(recording)) < 20
    assert find_problems(recording) == []


@pytest.mark.shared
def test_body25_and_coco17_are_the_same_detections(shared: Path) -> None:
    source = shared / "data/shelf/shelf.npz"
    coco, body = import_shelf(source), import_shelf(source, "body25")
    assert (coco.skeleton, body.skeleton) == (COCO17, BODY25)
    columns = [BODY25.index(name) for name in COCO17.joints]
    for one, other in zip(coco.views, body.views, strict=True):
        np.testing.assert_array_equal(one.keypoints_px, other.keypoints_px[:, columns])
