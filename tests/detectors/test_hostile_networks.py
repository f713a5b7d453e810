"""Networks that compute or take memory without an end: each is refused, and soon."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from tests.cases import each_case

from e3pose.base.child_process import call_apart
from e3pose.base.errors import InputError
from e3pose.detectors import inference
from e3pose.detectors.inference import load_network

CHECK = inference._check_bounds  # the session's tests go without it
SHAPE = [1, 3, 64, 64]
ONES = np.ones(16, np.float32)
Parts = tuple[list[onnx.NodeProto], list[onnx.TensorProto]]


def node(kind: str, inputs: str, output: str, **attributes: object) -> onnx.NodeProto:
    return helper.make_node(kind, inputs.split(), [output], **attributes)


def constant(name: str, value: object) -> onnx.TensorProto:
    return numpy_helper.from_array(np.asarray(value), name)


def summed(name: str) -> list[onnx.NodeProto]:
    """Return what makes the output depend on a constant."""
    return [node("ReduceSum", name, "sum", keepdims=0), node("Add", "image sum", "out")]


def doubled() -> Parts:
    """Doubles a constant without an end, while it is loaded: constants are folded then."""
    chain = [node("Concat", f"x{i} x{i}", f"x{i + 1}", axis=0) for i in range(40)]
    return [*chain, *summed("x40")], [constant("x0", ONES)]


def multiplied() -> Parts:
    chain = [node("MatMul", f"x{i} x{i}", f"x{i + 1}") for i in range(99)]
    return [*chain, *summed("x99")], [constant("x0", np.eye(2500, dtype=np.float32))]


def filled() -> Parts:
    shape = constant("shape", np.array([60_000, 60_000], np.int64))
    return [node("ConstantOfShape", "shape", "big"), *summed("big")], [shape]


def repeated() -> Parts:
    """A loop of 2**62 turns over the image."""
    value = helper.make_tensor_value_info
    turn, on = value("turn", TensorProto.INT64, []), value("on", TensorProto.BOOL, [])
    body = helper.make_graph(
        [node("Identity", "on", "again"), node("Identity", "x", "y")], "body",
        [turn, on, value("x", TensorProto.FLOAT, SHAPE)],
        [value("again", TensorProto.BOOL, []), value("y", TensorProto.FLOAT, SHAPE)],
    )  # fmt: skip
    turns = [constant("turns", np.int64(2**62)), constant("true", np.bool_(True))]
    return [node("Loop", "turns true image", "out", body=body)], turns


def announced() -> Parts:
    """Announces four terabytes of weights, and has four bytes."""
    weights = TensorProto(
        name="w", data_type=TensorProto.FLOAT, dims=[2**20, 2**20], raw_data=b"abcd"
    )
    return summed("w"), [weights]


def plain() -> Parts:
    return summed("x0"), [constant("x0", ONES)]


def write(path: Path, parts: Parts) -> Path:
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
        for name, shape in (("image", SHAPE), ("out", None))
    ]
    graph = helper.make_graph(parts[0], "graph", ends[:1], ends[1:], parts[1])
    opset = [helper.make_opsetid("", 17)]
    path.write_bytes(
        helper.make_model(graph, opset_imports=opset, ir_version=8).SerializeToString()
    )
    return path


@each_case("make", [doubled, multiplied, filled, repeated, announced])
def test_network_without_an_end_is_refused_soon(
    make: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("E3POSE_CACHE", str(tmp_path / "cache"))
    for name, value in {"_check_bounds": CHECK, "TRY_S": 1.2, "TRY_BYTES": 2 * 10**9}.items():
        monkeypatch.setattr(inference, name, value)
    path, begun_s = write(tmp_path / "net.onnx", make()), time.monotonic()  # type: ignore[operator]
    with pytest.raises(InputError, match=r"net\.onnx: .*expected a network that loads and runs"):
        load_network(path)
    assert time.monotonic() - begun_s < 1.2 + 25.0
    assert not (tmp_path / "cache").exists(), "tried again next time"


def test_network_is_tried_once_and_one_of_the_catalogue_never(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("E3POSE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(inference, "_check_bounds", CHECK)
    tries, real = list[Path](), call_apart

    def called(function: Any, path: Path, **bounds: Any) -> Any:
        tries.append(path)
        return real(function, path, **bounds)

    monkeypatch.setattr(inference, "call_apart", called)
    path = write(tmp_path / "net.onnx", plain())
    load_network(path, known=True)
    assert not tries
    for _ in range(2):
        assert load_network(path, "cpu", 1).run(np.zeros(SHAPE, np.float32))[0].mean() == 16.0
    assert tries == [path]
