"""ECPose on networks of its inputs and outputs whose answers follow from what they are shown."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from e3pose.base.errors import InputError
from e3pose.detectors import identify, make_detector, skeleton_of
from e3pose.detectors.focus import Focusing, Part
from e3pose.model.skeleton import COCO17

RED = np.zeros((480, 640, 3), np.uint8)
RED[..., 0] = 255


def write(
    path: Path,
    shares: NDArray[np.float64],
    labels: list[int],
    scores: NDArray[np.float64] | None = None,
    names: tuple[str, ...] = ("labels", "scores", "keypoints"),
) -> Path:
    """Write a network whose keypoints are these shares of the size that it is told.

    Args:
        path: of the file.
        shares: `(num_persons, 17, 2 or 3)`.
        labels: of each person.
        scores: of each person; None for the mean of the red channel, as normalised.
        names: of the outputs.
    """
    count = len(labels)
    wide = np.ones((count, 17, shares.shape[2]))
    wide[..., :2] = 0
    nodes = [
        helper.make_node("Cast", ["orig_target_sizes"], ["size"], to=TensorProto.FLOAT),
        helper.make_node("Concat", ["size", "one"], ["sized"], axis=1),
        helper.make_node("Slice", ["sized", "from", "width"], ["scale"]),
        helper.make_node("Mul", ["shares", "scale"], [names[2]]),
        helper.make_node("Identity", ["kinds"], [names[0]]),
        helper.make_node("Conv", ["images", "w"], ["red"], strides=[64, 64]),
        helper.make_node("ReduceMean", ["red"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "used"], ["felt"]),
        helper.make_node("Add", ["felt", "stated"], [names[1]]),
    ]
    red = np.zeros((1, 3, 64, 64))
    red[0, 0] = 1 / 64**2
    stated = np.zeros(count) if scores is None else scores
    constants = {
        "one": np.ones((1, 1)),
        "shares": shares[None],
        "w": red,
        "used": np.full((1, count), float(scores is None)),
        "stated": stated[None],
    }
    integers = {
        "from": np.array([0, 0]),
        "width": np.array([1, shares.shape[2]]),
        "kinds": np.array([labels]),
    }
    tensors = [numpy_helper.from_array(v.astype(np.float32), k) for k, v in constants.items()]
    tensors += [numpy_helper.from_array(v.astype(np.int64), k) for k, v in integers.items()]
    inputs = [
        helper.make_tensor_value_info("images", TensorProto.FLOAT, ("N", 3, 640, 640)),
        helper.make_tensor_value_info("orig_target_sizes", TensorProto.INT64, ("N", 2)),
    ]
    kinds: dict[str, tuple[Any, tuple[int, ...]]] = {
        names[0]: (TensorProto.INT64, (1, count)),
        names[1]: (TensorProto.FLOAT, (1, count)),
        names[2]: (TensorProto.FLOAT, (1, *shares.shape)),
    }
    outputs = [helper.make_tensor_value_info(name, *kind) for name, kind in kinds.items()]
    graph = helper.make_graph(nodes, "test", inputs, outputs, tensors)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, path)
    return path


def people(count: int, size: tuple[int, int] = (640, 480)) -> NDArray[np.float64]:
    """Return `(count, 17, 2)` pixels of people side by side."""
    shares = np.random.default_rng(count).uniform(0.1, 0.9, (count, 17, 2))
    shares[..., 0] = (shares[..., 0] + np.arange(count)[:, None]) / count
    return np.asarray(shares * size)


def test_people_are_where_they_are_in_the_image(tmp_path: Path) -> None:
    truth = people(4)
    shares = (truth + 0.5) / (640, 480)  # of the image, which is stretched to the input
    path = write(tmp_path / "e.onnx", shares, [1, 0, 1, 1], np.array([0.9, 0.9, 0.3, 0.7]))
    assert identify(path) == "ecpose" and skeleton_of("ecpose", path) == COCO17
    found = make_detector("ecpose", path, "cpu", 1).detect(RED)
    assert len(found) == 2  # one is of another label, one too unsure
    np.testing.assert_allclose(found.keypoints_px, truth[[0, 3]], atol=1e-3)
    np.testing.assert_allclose(found.scores, np.array([[0.9], [0.7]]) * np.ones(17), atol=1e-6)


def test_joints_may_have_scores(tmp_path: Path) -> None:
    shares = np.concatenate([people(1) / (640, 480), np.full((1, 17, 1), 0.6)], axis=2)
    path = write(tmp_path / "e.onnx", shares, [1], np.array([0.9]))
    found = make_detector("ecpose", path, "cpu", 1).detect(RED)
    np.testing.assert_allclose(found.scores, 0.6, atol=1e-6)


def test_the_image_is_rgb_and_normalised(tmp_path: Path) -> None:
    path = write(tmp_path / "e.onnx", people(1) / (640, 480), [1])
    image = np.where(RED > 0, 170, 0).astype(np.uint8)  # as blue, it were below the mean
    found = make_detector("ecpose", path, "cpu", 1).detect(image)
    assert found.scores[0, 0] == pytest.approx((170 / 255 - 0.485) / 0.229, abs=1e-3)


def test_the_same_person_twice_is_one(tmp_path: Path) -> None:
    truth = people(1)
    shares = np.concatenate([truth, truth + 2, truth + (90, 0)]) / (640, 480)
    path = write(tmp_path / "e.onnx", shares, [1, 1, 1], np.array([0.7, 0.9, 0.6]))
    found = make_detector("ecpose", path, "cpu", 1).detect(RED)
    np.testing.assert_allclose(found.scores[:, 0], [0.9, 0.6], atol=1e-6)


def test_a_part_of_the_image_fills_the_input(tmp_path: Path) -> None:
    part = Part(200, 100, 208, 104, 640)
    truth = people(1, part.size)[0] + (part.left, part.top)
    shares = (truth - (part.left, part.top) + 0.5) / part.size
    path = write(tmp_path / "e.onnx", shares[None], [1], np.array([0.9]))
    detector = make_detector("ecpose", path, "cpu", 1)
    assert isinstance(detector, Focusing)
    np.testing.assert_allclose(detector.detect_part(RED, part).keypoints_px[0], truth, atol=1e-3)


@pytest.mark.parametrize("names", [("labels", "scores", "boxes"), ("a", "b", "c")])
def test_other_outputs_are_refused(tmp_path: Path, names: tuple[str, ...]) -> None:
    path = write(tmp_path / "e.onnx", people(1) / 640, [1], np.array([0.9]), names)
    with pytest.raises(InputError, match=r"e\.onnx: outputs: found .*, expected scores \[1, N\]"):
        make_detector("ecpose", path, "cpu", 1)


@pytest.mark.parametrize("classes", [1, 2])  # people alone, or nobody before them
def test_rf_detr_gives_shares_and_logits(tmp_path: Path, classes: int) -> None:
    truth, path = people(3), tmp_path / "r.onnx"
    points = np.zeros((1, 3, 17 * classes, 7))
    points[0, :, -17:, :2], points[0, :, -17:, 2] = (truth + 0.5) / (640, 480), 1.0
    labels = np.full((1, 3, classes + 1), 900.0)  # of other columns nothing is taken
    labels[0, :, classes - 1] = (2.0, -0.1, 0.1)
    answers = {"dets": np.zeros((1, 3, 4)), "labels": labels, "keypoints": points}
    nodes = [helper.make_node("ReduceMean", ["input"], ["mean"], axes=[1, 2, 3], keepdims=0)]
    nodes += [helper.make_node("Mul", ["mean", "none"], ["zero"])]
    nodes += [helper.make_node("Add", ["zero", f"the {name}"], [name]) for name in answers]
    given = {"none": np.zeros(1), **{f"the {name}": value for name, value in answers.items()}}
    tensors = [numpy_helper.from_array(v.astype(np.float32), k) for k, v in given.items()]
    shape = helper.make_tensor_value_info("input", TensorProto.FLOAT, (1, 3, 576, 576))
    outputs = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, value.shape)
        for name, value in answers.items()
    ]
    graph = helper.make_graph(nodes, "test", [shape], outputs, tensors)
    onnx.save(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), path
    )
    assert identify(path) == "rf-detr" and skeleton_of("rf-detr", path) == COCO17
    found = make_detector("rf-detr", path, "cpu", 1).detect(RED)
    np.testing.assert_allclose(found.keypoints_px, truth[[0, 2]], atol=1e-3)
    np.testing.assert_allclose(found.scores, 1 / (1 + np.exp(-1.0)), atol=1e-6)
