"""Networks that are run: their outputs, and images that are fitted to them."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.detectors import identify, make_detector
from e3pose.detectors.base import poses_in_image
from e3pose.detectors.fit import Fit, letterbox, letterbox_to_side, stretch
from e3pose.detectors.focus import Focusing, Part
from e3pose.detectors.inference import choose_providers, load_network
from e3pose.detectors.yolo import keep_people

FLOAT, INT32 = 1, 6
IMAGE = np.full((480, 640, 3), 50, np.uint8)


def field(number: int, value: int | bytes | str) -> bytes:
    """One protobuf field."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def varint(value: int) -> bytes:
    out = b""
    while value > 127:
        out += bytes([value & 127 | 128])
        value >>= 7
    return out + bytes([value])


def value_info(name: str, kind: int, shape: tuple[int | str, ...]) -> bytes:
    dims = b"".join(
        field(1, field(1, side) if isinstance(side, int) else field(2, side)) for side in shape
    )
    return field(1, name) + field(2, field(1, field(1, kind) + field(2, dims)))


def write_onnx(
    path: Path,
    input_shape: tuple[int | str, ...],
    *outputs: NDArray[np.float32],
    kind: int = FLOAT,
) -> Path:
    """Write a network that gives `outputs` whatever it is shown."""
    graph = field(2, "constant")
    for index, array in enumerate(outputs):
        node = field(1, f"c{index}") + field(2, f"o{index}") + field(4, "Identity")
        tensor = b"".join(field(1, side) for side in array.shape) + field(2, FLOAT)
        raw = struct.pack(f"<{array.size}f", *array.ravel())
        graph += field(1, node) + field(5, tensor + field(8, f"c{index}") + field(9, raw))
        graph += field(12, value_info(f"o{index}", FLOAT, array.shape))
    graph += field(11, value_info("image", kind, input_shape))
    path.write_bytes(field(1, 8) + field(8, field(2, 13)) + field(7, graph))
    return path


def people_in(image_size: tuple[int, int], count: int) -> NDArray[np.float64]:
    """`(count, 17, 2)` pixels of people side by side."""
    generator = np.random.default_rng(count)
    keypoints = generator.uniform(0.1, 0.9, (count, 17, 2))
    keypoints[..., 0] = (keypoints[..., 0] + np.arange(count)[:, None]) / max(count, 1)
    return np.asarray(keypoints * image_size)


def test_movenet_reads_fractions_of_the_padded_input(tmp_path: Path) -> None:
    truth = people_in((640, 480), 2)
    rows = np.zeros((1, 6, 56), np.float32)
    # 640 x 480 fills 512 x 384 of the input, whose first pixel begins at fraction 0.
    rows[0, :2, 0:51:3] = ((truth[..., 1] + 0.5) * 0.8) / 384
    rows[0, :2, 1:51:3] = ((truth[..., 0] + 0.5) * 0.8) / 512
    rows[0, :2, 2:51:3] = 0.9
    rows[0, 0, 2] = 0.1  # a nose nobody believes
    rows[0, :3, 55] = 0.8, 0.3, 0.1  # the third person neither
    path = write_onnx(tmp_path / "m.onnx", (1, "h", "w", 3), rows, kind=INT32)
    assert identify(path) == "movenet-multipose"
    poses = make_detector("movenet-multipose", path, "cpu", 1).detect(IMAGE)
    assert len(poses) == 2 and poses.scores[0, 0] == 0 and np.isnan(poses.keypoints_px[0, 0, 0])
    assert np.abs(poses.keypoints_px[0, 1:] - truth[0, 1:]).max() < 1e-3
    assert np.abs(poses.keypoints_px[1] - truth[1]).max() < 1e-3


@pytest.mark.parametrize("turned", [False, True])
def test_yolo_reads_either_orientation(tmp_path: Path, turned: bool) -> None:
    truth = people_in((640, 480), 3)
    # 640 x 480 lies unscaled in 640 x 640, 80 rows of grey above it.
    points = truth + 0.5 + [0, 80]
    rows = np.zeros((200, 56), np.float32)
    for index, person in enumerate(points):
        low, high = person.min(axis=0), person.max(axis=0)
        rows[index, :5] = *(low + high) / 2, *(high - low), 0.9 - 0.1 * index
        rows[index, 5::3], rows[index, 6::3], rows[index, 7::3] = person[:, 0], person[:, 1], 0.8
        rows[index + 10] = rows[index]  # the same person again, a little off and less sure
        rows[index + 10, :5] += 2, 2, 0, 0, -0.05
    output = (rows if turned else rows.T)[None]
    path = write_onnx(tmp_path / "y.onnx", (1, 3, 640, 640), np.ascontiguousarray(output))
    assert identify(path) == "yolo-pose"
    poses = make_detector(str(path), None, "cpu").detect(IMAGE)
    assert len(poses) == 3
    assert np.abs(poses.keypoints_px - truth).max() < 1e-3
    np.testing.assert_allclose(poses.scores, 0.8, atol=1e-6)


@pytest.mark.parametrize("sides", [(640, 640), ("h", "w")])
def test_yolo_looks_at_a_part(tmp_path: Path, sides: tuple[int | str, ...]) -> None:
    part = Part(100, 40, 320, 240, 384)
    truth = people_in(part.size, 1)[0] + (part.left, part.top)
    # 320 x 240 doubled lies in 640 x 640 below 80 rows of grey, or fills the top of 384 x 288.
    scale, below = (2.0, 80) if sides == (640, 640) else (1.2, 0)
    points = (truth - (part.left, part.top) + 0.5) * scale + (0, below)
    low, high = points.min(axis=0), points.max(axis=0)
    row = np.zeros((1, 56), np.float32)
    row[0, :5] = *(low + high) / 2, *(high - low), 0.9
    row[0, 5::3], row[0, 6::3], row[0, 7::3] = points[:, 0], points[:, 1], 0.8
    path = write_onnx(tmp_path / "y.onnx", (1, 3, *sides), np.ascontiguousarray(row.T[None]))
    detector = make_detector("yolo-pose", path, "cpu", 1)
    assert isinstance(detector, Focusing)
    (found,) = detector.detect_part(IMAGE, part).keypoints_px
    assert np.abs(found - truth).max() < 1e-3


def test_network_whose_input_may_have_any_size_takes_crops(tmp_path: Path) -> None:
    rows, maps = np.zeros((1, 6, 56), np.float32), np.zeros((1, 57, 8, 8), np.float32)
    parts = [np.zeros((1, count, 8, 8), np.float32) for count in (18, 42)]
    path = tmp_path / "n.onnx"

    def takes_crops(name: str) -> bool:
        return bool(getattr(make_detector(name, path, "cpu", 1), "free_input", False))

    write_onnx(path, (1, "h", "w", 3), rows, kind=INT32)
    assert takes_crops("movenet-multipose")
    write_onnx(path, (1, 256, 256, 3), rows, kind=INT32)
    assert not takes_crops("movenet-multipose")
    write_onnx(path, (1, 3, "h", "w"), maps)
    assert takes_crops("openpose-thin")
    write_onnx(path, (1, 3, 368, 432), maps)
    assert not takes_crops("openpose-thin")
    write_onnx(path, (1, 3, "h", "w"), *parts)
    assert not takes_crops("trt-pose")  # it stretches
    write_onnx(path, (1, 3, "h", "w"), rows)
    assert not takes_crops("yolo-pose")  # it pads with grey


def test_boxes_that_are_not_numbers_are_nobody() -> None:
    boxes = np.array([[5, 5, 4, 4], [np.nan, 5, 4, 4], [50, 5, 4, 4]], dtype=np.float64)
    assert keep_people(boxes, np.array([0.5, 0.9, 0.8])).tolist() == [2, 0]
    assert keep_people(boxes[:0], np.zeros(0)).tolist() == []


def test_a_kind_is_reported_from_its_outputs(tmp_path: Path) -> None:
    thin = write_onnx(tmp_path / "a.onnx", (1, 3, "h", "w"), np.zeros((1, 57, 4, 4), np.float32))
    assert identify(thin) == "openpose-thin"
    maps = [np.zeros((1, count, 8, 8), np.float32) for count in (18, 42)]
    trt = write_onnx(tmp_path / "b.onnx", (1, 3, 224, 224), *maps)
    assert identify(trt) == "trt-pose"
    assert len(make_detector(str(trt)).detect(IMAGE)) == 0
    other = write_onnx(tmp_path / "c.onnx", (1, 3, 8, 8), np.zeros((1, 1000), np.float32))
    with pytest.raises(InputError, match=r"c\.onnx: found input \[1, 3, 8, 8\].*expected"):
        identify(other)


@each_case("name", ["movenet-multipose", "openpose-thin", "trt-pose", "yolo-pose", "rtmo"])
def test_another_network_is_refused_by_name(tmp_path: Path, name: str) -> None:
    path = write_onnx(tmp_path / "c.onnx", (1, 3, 8, 8), np.zeros((1, 1000), np.float32))
    with pytest.raises(
        InputError, match=rf"c\.onnx: (in|out)puts?: found .* expected .* for {name}"
    ):
        make_detector(name, path)


@each_case("suffix", [".onnx", ".pb"])
@each_case("content", [b"", b"garbage" * 100, b"\x08\x08\x3a\xff\xff\xff\x7f", b"\0"])
def test_a_damaged_file_is_named(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"broken{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        make_detector("openpose-thin", path).detect(IMAGE)
    assert "broken" in str(caught.value) and "\n" not in str(caught.value)


@each_case(
    ("name", "model", "message"),
    [
        ("mediapipe", None, "detector: found 'mediapipe', expected one of movenet-multipose"),
        ("trt-pose", None, "trt-pose: has no published weights, expected your own file"),
        ("openpose-thin", "gone.onnx", r"gone\.onnx: no such file"),
        ("gone.onnx", None, r"gone\.onnx: no such file"),
        ("openpose-thin", "model.h5", "found suffix '.h5'"),
        ("rtmpose", "model.h5", r"model\.h5: found a file, expected a folder"),
    ],
)
def test_wrong_names_and_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, model: str | None, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("model.h5").write_bytes(b"x")
    with pytest.raises(InputError, match=message):
        make_detector(name, Path(model) if model else None)


def test_the_best_provider_is_taken_and_a_forced_one_must_be_there(tmp_path: Path) -> None:
    tensorrt, cuda, cpu = (f"{n}ExecutionProvider" for n in ("Tensorrt", "CUDA", "CPU"))

    def names(provider: str, *available: str) -> list[str]:
        chosen = choose_providers(provider, available, tmp_path)
        return [entry if isinstance(entry, str) else entry[0] for entry in chosen]

    assert names("auto", "AzureExecutionProvider", cpu) == [cpu]
    assert names("auto", cpu, cuda) == [cuda, cpu]
    assert names("auto", cpu, cuda, tensorrt) == [tensorrt, cuda, cpu]
    assert names("auto", cpu, "OpenVINOExecutionProvider") == ["OpenVINOExecutionProvider", cpu]
    assert names("cpu", cpu, cuda, tensorrt) == [cpu]
    assert names("tensorrt", cpu, cuda, tensorrt) == [tensorrt, cuda]
    options = choose_providers("tensorrt", [tensorrt], tmp_path)[0][1]
    assert isinstance(options, dict) and options["trt_engine_cache_path"] == str(tmp_path)
    assert options["trt_fp16_enable"]
    openvino = choose_providers("openvino", ["OpenVINOExecutionProvider"], tmp_path)
    assert openvino == [("OpenVINOExecutionProvider", {"cache_dir": str(tmp_path)})]
    with pytest.raises(InputError, match="cuda is not in this ONNX Runtime, which has cpu"):
        names("cuda", cpu)
    with pytest.raises(
        InputError, match="found 'gpu', expected auto, tensorrt, cuda, openvino, coreml, cpu"
    ):
        names("gpu", cpu)


def test_forcing_a_provider_that_is_absent_is_one_clear_line(tmp_path: Path) -> None:
    path = write_onnx(tmp_path / "a.onnx", (1, 3, "h", "w"), np.zeros((1, 57, 4, 4), np.float32))
    import onnxruntime

    if "TensorrtExecutionProvider" in onnxruntime.get_available_providers():
        pytest.skip("this machine has TensorRT")
    with pytest.raises(InputError, match="tensorrt is not in this ONNX Runtime"):
        make_detector("openpose-thin", path, "tensorrt")
    graph = tmp_path / "g.pb"
    graph.write_bytes(b"x")
    with pytest.raises(InputError, match=r"g\.pb: provider: a TensorFlow graph runs on the cpu"):
        load_network(graph, "cuda")
    with pytest.raises(InputError, match="threads: found 0"):
        load_network(path, threads=0)


@pytest.mark.parametrize("swapped", [False, True])
def test_rtmo_reads_boxes_and_keypoints(tmp_path: Path, swapped: bool) -> None:
    truth = people_in((640, 480), 3)
    # 640 x 480 fills the top 416 x 312 of 416 x 416.
    points = np.zeros((1, 5, 17, 3), np.float32)
    points[0, :3, :, :2] = (truth + 0.5) * 0.65
    points[0, :3, :, 2] = 0.8
    points[0, 0, 3, 2] = 0.2  # an ear nobody believes
    boxes = np.zeros((1, 5, 5), np.float32)
    boxes[0, :, 4] = 0.9, 0.8, 0.1, 0.05, 0.0  # nor the third person
    outputs = (points, boxes) if swapped else (boxes, points)
    path = write_onnx(tmp_path / "r.onnx", (1, 3, 416, 416), *outputs)
    assert identify(path) == "rtmo"
    poses = make_detector("rtmo", path, "cpu", 1).detect(IMAGE)
    assert len(poses) == 2 and poses.scores[0, 3] == 0
    seen = poses.scores > 0
    assert seen.sum() == 33
    assert np.abs(poses.keypoints_px - truth[:2])[seen].max() < 1e-3
    np.testing.assert_allclose(poses.scores[seen], 0.8, atol=1e-6)


def test_rtmo_finds_nobody_twice(tmp_path: Path) -> None:
    truth = people_in((640, 480), 1)[0]
    behind = truth + (60, 0)  # somebody else, in nearly the same box
    points = np.full((1, 3, 17, 3), 0.8, np.float32)
    points[0, :, :, :2] = (np.stack([truth + 1, truth, behind]) + 0.5) * 0.65
    points[0, 1, :, 2] = 0.9
    boxes = np.full((1, 3, 5), 0.9, np.float32)
    path = write_onnx(tmp_path / "r.onnx", (1, 3, 416, 416), boxes, points)
    found = make_detector("rtmo", path, "cpu", 1).detect(IMAGE)
    assert np.abs(found.keypoints_px - np.stack([truth, behind])).max() < 1e-3


def test_rtmo_looks_at_a_part(tmp_path: Path) -> None:
    part = Part(200, 100, 208, 104, 640)  # doubled, it fills the top half of 416 x 416
    truth = people_in(part.size, 1)[0] + (part.left, part.top)
    points = np.full((1, 1, 17, 3), 0.8, np.float32)
    points[0, 0, :, :2] = (truth - (part.left, part.top) + 0.5) * 2
    boxes = np.full((1, 1, 5), 0.9, np.float32)
    detector = make_detector(
        "rtmo", write_onnx(tmp_path / "r.onnx", (1, 3, 416, 416), boxes, points), "cpu", 1
    )
    assert isinstance(detector, Focusing)
    (found,) = detector.detect_part(IMAGE, part).keypoints_px
    assert np.abs(found - truth).max() < 1e-3


def test_rtmo_of_no_people_finds_nobody_and_of_another_skeleton_is_refused(tmp_path: Path) -> None:
    empty = (np.zeros((1, 0, 5), np.float32), np.zeros((1, 0, 17, 3), np.float32))
    path = write_onnx(tmp_path / "r.onnx", (1, 3, 640, 640), *empty)
    assert len(make_detector("rtmo", path, "cpu", 1).detect(IMAGE)) == 0
    other = (np.zeros((1, 2, 5), np.float32), np.zeros((1, 2, 26, 3), np.float32))
    write_onnx(path, (1, 3, 640, 640), *other)
    with pytest.raises(
        InputError, match=r"expected dets \[1, N, 5\] and keypoints \[1, N, 17, 3\]"
    ):
        make_detector("rtmo", path, "cpu", 1)


SIZES = [(640, 480), (480, 640), (1920, 1088), (97, 331), (640, 640)]
FITS = {
    "stretch": lambda size: stretch(size, (224, 224)),
    "corner": lambda size: letterbox(size, (512, 288)),
    "centred": lambda size: letterbox(size, (640, 640), centred=True),
    "side": lambda size: letterbox_to_side(size, 432, 16),
}


@each_case("size", SIZES)
@each_case("kind", FITS)
def test_a_spot_comes_back_to_where_it_was(kind: str, size: tuple[int, int]) -> None:
    """Where the resized image really has the spot is what `to_image` must undo."""
    fit: Fit = FITS[kind](size)
    rows, columns = np.mgrid[: size[1], : size[0]]
    for x, y in ((0.5, 0.5), (0.23, 0.71), (0.8, 0.31)):
        centre = np.array([x * size[0], y * size[1]])
        radius = min(size) / 20
        spot = np.exp(-((columns - centre[0]) ** 2 + (rows - centre[1]) ** 2) / (2 * radius**2))
        image = np.repeat((255 * spot).astype(np.uint8)[..., None], 3, axis=2)
        seen = fit.apply(image, 0)[..., 0].astype(np.float64)
        assert seen.shape == fit.input_size[::-1]
        v, u = np.mgrid[: seen.shape[0], : seen.shape[1]]
        mean = np.array([(u * seen).sum(), (v * seen).sum()]) / seen.sum()
        assert np.abs(fit.to_image(mean) - centre).max() < 0.1


def test_proportions_and_padding() -> None:
    fit = letterbox(size := (1000, 500), (640, 640), centred=True)
    assert (fit.content_size, fit.corner) == ((640, 320), (0, 160))
    canvas = fit.apply(np.full((500, 1000, 3), 7, np.uint8), 114)
    assert (canvas[:160] == 114).all() and (canvas[160:480] == 7).all() and size == fit.image_size
    fit = letterbox_to_side((1920, 1080), 432, 16)
    assert (fit.input_size, fit.content_size, fit.corner) == ((432, 256), (432, 243), (0, 0))
    fit = letterbox_to_side((10_000, 1), 432, 16)
    assert fit.content_size == (432, 1)


def test_what_nobody_should_believe_is_missing() -> None:
    keypoints = np.array([[[-0.4, 3], [-0.6, 3], [5, 5], [9.4, 5]], [[99.0, 1]] * 4])
    scores = np.array([[1.2, 1, 0.1, np.nan], [1, 1, 1, 1]])
    poses = poses_in_image(keypoints, scores, (10, 10), min_score=0.2)
    assert len(poses) == 1  # the other one is wholly outside
    np.testing.assert_array_equal(poses.scores[0], [1, 0, 0, 0])
    np.testing.assert_array_equal(np.isnan(poses.keypoints_px[0, :, 0]), [False, True, True, True])


@each_case("size", SIZES)
@each_case("kind", FITS)
def test_places_in_the_input_are_those_of_the_image(kind: str, size: tuple[int, int]) -> None:
    fit: Fit = FITS[kind](size)
    points = np.array([[-0.5, -0.5], [3.0, 40.0], [size[0] - 0.5, size[1] - 0.5]])
    np.testing.assert_allclose(fit.to_image(fit.to_input(points)), points)
    np.testing.assert_allclose(fit.to_input(points[0]), np.array(fit.corner) - 0.5)
