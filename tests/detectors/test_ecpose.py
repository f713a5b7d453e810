"""ECPose on networks of its inputs and outputs whose answers follow from what they are shown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from onnx import TensorProto, helper
from tests.detectors.test_networks import people_in
from tests.detectors.test_top_down import constant, floats
from tests.detectors.test_top_down import write as write_network

from e3pose.base.errors import InputError
from e3pose.detectors import identify, make_detector, skeleton_of
from e3pose.detectors.focus import Focusing, Part
from e3pose.model.skeleton import COCO17

SIZE = (640, 480)
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

    Scores that are not given are the mean of the red channel, as normalised.
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
    tensors = [constant(name, value.astype(np.float32)) for name, value in constants.items()]
    tensors += [constant(name, value.astype(np.int64)) for name, value in integers.items()]
    inputs = [
        floats("images", "N", 3, 640, 640),
        helper.make_tensor_value_info("orig_target_sizes", TensorProto.INT64, ("N", 2)),
    ]
    outputs = [
        helper.make_tensor_value_info(names[0], TensorProto.INT64, (1, count)),
        floats(names[1], 1, count),
        floats(names[2], 1, *shares.shape),
    ]
    return write_network(path, nodes, inputs, outputs, *tensors)


def test_people_are_where_they_are_in_the_image(tmp_path: Path) -> None:
    truth = people_in(SIZE, 4)
    shares = (truth + 0.5) / SIZE  # of the image, which is stretched to the input
    path = write(tmp_path / "e.onnx", shares, [1, 0, 1, 1], np.array([0.9, 0.9, 0.3, 0.7]))
    assert identify(path) == "ecpose" and skeleton_of("ecpose", path) == COCO17
    found = make_detector("ecpose", path, "cpu", 1).detect(RED)
    assert len(found) == 2  # one is of another label, one too unsure
    np.testing.assert_allclose(found.keypoints_px, truth[[0, 3]], atol=1e-3)
    np.testing.assert_allclose(found.scores, np.array([[0.9], [0.7]]) * np.ones(17), atol=1e-6)


def test_joints_may_have_scores(tmp_path: Path) -> None:
    shares = np.concatenate([people_in(SIZE, 1) / SIZE, np.full((1, 17, 1), 0.6)], axis=2)
    path = write(tmp_path / "e.onnx", shares, [1], np.array([0.9]))
    found = make_detector("ecpose", path, "cpu", 1).detect(RED)
    np.testing.assert_allclose(found.scores, 0.6, atol=1e-6)


def test_the_image_is_rgb_and_normalised(tmp_path: Path) -> None:
    path = write(tmp_path / "e.onnx", people_in(SIZE, 1) / SIZE, [1])
    image = np.where(RED > 0, 170, 0).astype(np.uint8)  # as blue, it were below the mean
    found = make_detector("ecpose", path, "cpu", 1).detect(image)
    assert found.scores[0, 0] == pytest.approx((170 / 255 - 0.485) / 0.229, abs=1e-3)


def test_the_same_person_twice_is_one(tmp_path: Path) -> None:
    truth = people_in(SIZE, 1)
    shares = np.concatenate([truth, truth + 2, truth + (90, 0)]) / SIZE
    path = write(tmp_path / "e.onnx", shares, [1, 1, 1], np.array([0.7, 0.9, 0.6]))
    found = make_detector("ecpose", path, "cpu", 1).detect(RED)
    np.testing.assert_allclose(found.scores[:, 0], [0.9, 0.6], atol=1e-6)


def test_a_part_of_the_image_fills_the_input(tmp_path: Path) -> None:
    part = Part(200, 100, 208, 104, 640)
    truth = people_in(part.size, 1)[0] + (part.left, part.top)
    shares = (truth - (part.left, part.top) + 0.5) / part.size
    path = write(tmp_path / "e.onnx", shares[None], [1], np.array([0.9]))
    detector = make_detector("ecpose", path, "cpu", 1)
    assert isinstance(detector, Focusing)
    np.testing.assert_allclose(detector.detect_part(RED, part).keypoints_px[0], truth, atol=1e-3)


@pytest.mark.parametrize("names", [("labels", "scores", "boxes"), ("a", "b", "c")])
def test_other_outputs_are_refused(tmp_path: Path, names: tuple[str, ...]) -> None:
    path = write(tmp_path / "e.onnx", people_in(SIZE, 1) / 640, [1], np.array([0.9]), names)
    with pytest.raises(InputError, match=r"e\.onnx: outputs: found .*, expected scores \[1, N\]"):
        make_detector("ecpose", path, "cpu", 1)


@pytest.mark.parametrize("classes", [1, 2])  # people alone, or nobody before them
def test_rf_detr_gives_shares_and_logits(tmp_path: Path, classes: int) -> None:
    truth, path = people_in(SIZE, 3), tmp_path / "r.onnx"
    points = np.zeros((1, 3, 17 * classes, 7))
    points[0, :, -17:, :2], points[0, :, -17:, 2] = (truth + 0.5) / SIZE, 1.0
    labels = np.full((1, 3, classes + 1), 900.0)  # of other columns nothing is taken
    labels[0, :, classes - 1] = (2.0, -0.1, 0.1)
    answers = {"dets": np.zeros((1, 3, 4)), "labels": labels, "keypoints": points}
    nodes = [helper.make_node("ReduceMean", ["input"], ["mean"], axes=[1, 2, 3], keepdims=0)]
    nodes += [helper.make_node("Mul", ["mean", "none"], ["zero"])]
    nodes += [helper.make_node("Add", ["zero", f"the {name}"], [name]) for name in answers]
    given = {"none": np.zeros(1), **{f"the {name}": value for name, value in answers.items()}}
    tensors = [constant(name, value.astype(np.float32)) for name, value in given.items()]
    outputs = [floats(name, *value.shape) for name, value in answers.items()]
    write_network(path, nodes, [floats("input", 1, 3, 576, 576)], outputs, *tensors)
    assert identify(path) == "rf-detr" and skeleton_of("rf-detr", path) == COCO17
    found = make_detector("rf-detr", path, "cpu", 1).detect(RED)
    np.testing.assert_allclose(found.keypoints_px, truth[[0, 2]], atol=1e-3)
    np.testing.assert_allclose(found.scores, 1 / (1 + np.exp(-1.0)), atol=1e-6)
