"""Top-down detectors on networks whose outputs follow from what they are shown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.detectors import identify, make_detector, skeleton_of
from e3pose.detectors.focus import detect_expected
from e3pose.detectors.inference import load_network
from e3pose.detectors.top_down import PersonBoxes, crop, different_people, read_heatmaps, read_simcc
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17, HALPE26, SKELETONS

DOTS = ((420.0, 90.0), (380.0, 200.0), (450.0, 330.0))  # red, green, blue; pixels of the image
BOX = (340.0, 60.0, 500.0, 360.0)
OTHER = (40.0, 100.0, 140.0, 300.0)


def write(path: Path, nodes: list[Any], inputs: list[Any], outputs: list[Any], *more: Any) -> Path:
    graph = helper.make_graph(nodes, "test", inputs, outputs, list(more))
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.checker.check_model(model)
    path.parent.mkdir(exist_ok=True)
    onnx.save(model, path)
    return path


def floats(name: str, *shape: int | str) -> Any:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)


def constant(name: str, value: NDArray[Any]) -> Any:
    return numpy_helper.from_array(value, name)


def write_boxes(
    path: Path, rows: list[list[float]], labels: list[int], first: str = "Conv"
) -> Path:
    """Write a network that finds these boxes whatever it is shown: pixels of 320 x 320.

    The score of the last box is the value of the input's first pixel: blue, as it is BGR.
    """
    dets, kinds = np.array([[*rows, [0, 0, 320, 320, 0]]], np.float32), [[*labels, 0]]
    corner = constant("from", np.zeros(4, np.int64)), constant("to", np.ones(4, np.int64))
    readers = {
        "Conv": helper.make_node("Conv", ["image", "w"], ["seen"], strides=[320, 320]),
        "Slice": helper.make_node("Slice", ["image", "from", "to"], ["seen"]),
        "Neg": helper.make_node("Neg", ["image"], ["seen"]),
    }
    place = np.zeros((1, *dets.shape[1:]), np.float32)
    place[0, -1, 4] = 1
    nodes = [
        helper.make_node("Cast", ["input"], ["image"], to=TensorProto.FLOAT),
        readers[first],
        helper.make_node("ReduceMax", ["seen"], ["value"], keepdims=0),
        helper.make_node("Mul", ["value", "place"], ["score"]),
        helper.make_node("Add", ["d", "score"], ["dets"]),
        helper.make_node("Identity", ["l"], ["labels"]),
    ]
    outputs = [
        floats("dets", *dets.shape),
        helper.make_tensor_value_info("labels", TensorProto.INT64, (1, dets.shape[1])),
    ]
    weights = np.zeros((1, 3, 1, 1), np.float32)
    weights[0, 0] = 1
    more = [constant("d", dets), constant("l", np.array(kinds, np.int64))]
    more += [constant("w", weights), constant("place", place), *corner]
    return write(path, nodes, [floats("input", 1, 3, 320, 320)], outputs, *more)


def write_keypoints(path: Path, count: int, heatmaps: bool = False) -> Path:
    """Write a network whose keypoint k is where red, green or blue (k mod 3) is brightest."""
    weights = np.zeros((count, 3, 1, 1), np.float32)
    weights[np.arange(count), np.arange(count) % 3] = 4.0
    bias = np.full(count, -4.0, np.float32)
    nodes = [
        helper.make_node("Conv", ["input", "w", "b"], ["c"]),
        helper.make_node("Sigmoid", ["c"], ["maps"]),
    ]
    image, more = floats("input", 1, 3, 256, 192), [constant("w", weights), constant("b", bias)]
    if heatmaps:
        pool = helper.make_node("AveragePool", ["maps"], ["h"], kernel_shape=[4, 4], strides=[4, 4])
        return write(path, [*nodes, pool], [image], [floats("h", 1, count, 64, 48)], *more)
    sides = {"x": (2, 192), "y": (3, 256)}
    for name, (axis, side) in sides.items():
        more += [
            constant(f"s{name}", np.array([1, count, side, 1], np.int64)),
            constant(f"t{name}", np.array([1, 1, 1, 2], np.int64)),
            constant(f"e{name}", np.array([1, count, 2 * side], np.int64)),
        ]
        nodes += [
            helper.make_node("ReduceMax", ["maps"], [f"m{name}"], axes=[axis], keepdims=0),
            helper.make_node("Reshape", [f"m{name}", f"s{name}"], [f"r{name}"]),
            helper.make_node("Tile", [f"r{name}", f"t{name}"], [f"d{name}"]),
            helper.make_node("Reshape", [f"d{name}", f"e{name}"], [f"simcc_{name}"]),
        ]
    outputs = [floats(f"simcc_{name}", 1, count, 2 * side) for name, (_, side) in sides.items()]
    return write(path, nodes, [image], outputs, *more)


def picture() -> NDArray[np.uint8]:
    """Return 640 x 480 with a soft red, a green and a blue dot."""
    rows, columns = np.mgrid[:480, :640]
    image = np.zeros((480, 640, 3))
    for channel, (x, y) in enumerate(DOTS):
        image[..., channel] = 255 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 8.0**2))
    return np.asarray(image.round(), dtype=np.uint8)


def in_network(box: tuple[float, ...]) -> list[float]:
    """Return a box in the 320 x 320 input, half the size of the image."""
    return [side / 2 for side in box]


@each_case(("count", "skeleton"), [(17, COCO17), (26, HALPE26), (133, SKELETONS["coco133"])])
@each_case("heatmaps", [False, True])
def test_keypoints_are_where_they_are_in_the_image(
    tmp_path: Path, count: int, skeleton: Any, heatmaps: bool
) -> None:
    folder = tmp_path / "networks"
    rows = [[*in_network(OTHER), 0.9], [*in_network(BOX), 0.8], [*in_network(BOX), 0.2]]
    write_boxes(folder / "a.onnx", rows, [56, 0, 0])  # a chair, a person, one too unsure
    write_keypoints(folder / "b.onnx", count, heatmaps)
    kind = "vitpose" if heatmaps else "rtmpose"
    assert identify(folder) == kind and skeleton_of(kind, folder) == skeleton
    for detector in (make_detector(str(folder), None, "cpu", 1), make_detector(kind, folder)):
        assert detector.skeleton == skeleton
        poses = detector.detect(picture())
        assert poses.keypoints_px.shape == (1, count, 2)
        expected = np.array([DOTS[k % 3] for k in range(count)])
        # A heatmap's cell is 4 pixels of the input, and those are 1.5 of the image.
        assert np.abs(poses.keypoints_px[0] - expected).max() < (3.5 if heatmaps else 1.0)
        assert (poses.scores > 0.9).all()


@pytest.mark.parametrize(("first", "value"), [("Conv", (80 - 103.53) / 57.375), ("Slice", 80.0)])
def test_images_are_normalised_for_rtmdet_and_not_for_yolox(
    tmp_path: Path, first: str, value: float
) -> None:
    network = load_network(write_boxes(tmp_path / "a.onnx", [], [], first), "cpu", 1)
    seen: list[NDArray[Any]] = []

    def watched(tensor: NDArray[Any]) -> list[NDArray[Any]]:
        seen.extend(network.run(tensor))
        return seen[-2:]

    image = np.zeros((320, 320, 3), np.uint8)
    image[0, 0] = 255, 40, 80  # RGB
    boxes = PersonBoxes(replace(network, run=watched)).find(image)
    assert seen[0][0, -1, 4] == pytest.approx(value, abs=1e-4)
    assert len(boxes) == (value > 0.3)


def test_boxes_of_a_network_that_is_neither_are_refused(tmp_path: Path) -> None:
    write_boxes(tmp_path / "a.onnx", [], [], "Neg")
    write_keypoints(tmp_path / "b.onnx", 17)
    wanted = r"a\.onnx: found an image that is first read by Neg, expected Conv as in RTMDet, or "
    with pytest.raises(InputError, match=wanted):
        make_detector("rtmpose", tmp_path)


def test_people_are_looked_for_where_they_are_expected(tmp_path: Path) -> None:
    write_boxes(tmp_path / "a.onnx", [[*in_network(OTHER), 0.9]], [0])  # the wrong place
    write_keypoints(tmp_path / "b.onnx", 26)
    detector = make_detector("rtmpose", tmp_path)
    truth = np.array([DOTS[k % 3] for k in range(26)])
    off = np.tile([25.0, -20.0], (26, 1))
    twice = ExpectedView(np.stack([truth, truth + off]), np.array([10.0, 10.0]))
    found = detect_expected(detector, picture(), twice)
    assert len(found) == 1  # both boxes show the same person
    assert np.abs(found.keypoints_px[0] - truth).max() < 1.5
    away = ExpectedView(truth[None] - (300.0, 0.0), np.array([10.0]))
    assert len(detect_expected(detector, picture(), away)) == 0
    nobody = detect_expected(detector, picture(), None)  # that network sees nobody there
    assert nobody.keypoints_px.shape == (0, 26, 2)


def test_two_people_side_by_side_are_two() -> None:
    one = np.random.default_rng(0).uniform(0, 100, (17, 2))
    few = np.where(np.arange(17)[:, None] < 3, one + 500, np.nan)
    points = np.stack([one, one + (30, 0), one + (3, 2), few])
    scores = np.where(np.isfinite(points[..., 0]), 0.5, 0.0)
    scores[2] = 0.9  # surer than the first, who is the same
    found = different_people(Poses2D(points, scores))
    np.testing.assert_array_equal(found.keypoints_px, points[1:3])
    assert len(different_people(Poses2D.empty(17))) == 0


def test_a_box_fills_the_input_with_its_margin() -> None:
    box = np.array([100.0, 50.0, 200.0, 250.0])
    for whole, size in ((False, (192, 256)), (True, (191, 255))):
        to_input = crop(box, (192, 256), whole_cells=whole)
        middle = to_input @ [149.5, 149.5, 1]
        assert middle == pytest.approx(np.array(size) / 2)
        top = to_input @ [149.5, 149.5 - 1.25 * 100, 1]
        assert top[1] == pytest.approx(0) and to_input[0, 0] == to_input[1, 1]


def test_peaks_between_cells_are_found() -> None:
    rows, columns = np.mgrid[:64, :48]
    places = np.array([[10.3, 20.8], [0.0, 63.0], [46.9, 5.5]])  # cells
    maps = np.stack(
        [np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 2.0**2)) for x, y in places]
    )
    keypoints, scores = read_heatmaps(maps, (192, 256))
    assert keypoints / [191 / 47, 255 / 63] == pytest.approx(places, abs=0.11)
    assert keypoints[:2] / [191 / 47, 255 / 63] == pytest.approx(places[:2], abs=1e-6)
    assert (scores > 0.9).all()
    assert read_heatmaps(np.zeros((2, 64, 48)), (192, 256))[1].tolist() == [0, 0]


def test_classes_are_half_pixels_and_the_lower_score_counts() -> None:
    x, y = np.zeros((2, 384)), np.zeros((2, 512))
    x[0, 101], y[0, 300], x[1, 0], y[1, 511] = 0.9, 0.4, 0.2, 0.8
    keypoints, scores = read_simcc(x, y, (192, 256))
    assert keypoints.tolist() == [[50.5, 150.0], [0.0, 255.5]] and scores.tolist() == [0.4, 0.2]


def test_wrong_folders_are_one_line_each(tmp_path: Path) -> None:
    folder = tmp_path / "networks"
    boxes = write_boxes(folder / "a.onnx", [[0, 0, 9, 9, 0.9]], [0])
    with pytest.raises(InputError, match=r"networks: found 1 \.onnx files, expected two"):
        make_detector("rtmpose", folder)
    (folder / "b.onnx").write_bytes(boxes.read_bytes())
    with pytest.raises(InputError, match=r"b\.onnx: found input .* of K = 17, 26 or 133 keypoints"):
        make_detector("rtmpose", folder)
    write_keypoints(folder / "b.onnx", 21)
    with pytest.raises(InputError, match=r"b\.onnx: found input .* of K = 17, 26 or 133 keypoints"):
        identify(folder)
    write_keypoints(folder / "b.onnx", 17)
    with pytest.raises(InputError, match="a network of the kind rtmpose, expected vitpose"):
        make_detector("vitpose", folder)
    write_keypoints(folder / "a.onnx", 17)
    with pytest.raises(InputError, match=r"\.onnx: found input .* dets \[1, N, 5\] and labels"):
        make_detector("rtmpose", folder)
    with pytest.raises(InputError, match="model: found none, expected the folder"):
        make_detector("rtmpose")
