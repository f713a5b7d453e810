"""Networks whose weights are in other files: read from their own folder, from nowhere else."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.detectors.inference import load_network
from e3pose.predict import make_predictor
from e3pose.predict.attention_lstm import SHIPPED

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed: pip install e3pose[edge]")
onnx = pytest.importorskip("onnx", reason="onnx is not installed: pip install e3pose[edge]")

pytestmark = pytest.mark.slow


def with_weights_beside(folder: Path) -> Path:
    """Save a network that multiplies by the ones of a file beside it."""
    helper, floats = onnx.helper, onnx.TensorProto.FLOAT
    weights = onnx.numpy_helper.from_array(np.ones((300, 3), np.float32), "w")
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["x", "w"], ["y"])],
        "network",
        [helper.make_tensor_value_info("x", floats, [1, 300])],
        [helper.make_tensor_value_info("y", floats, [1, 3])],
        [weights],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    folder.mkdir()
    onnx.save_model(
        model, str(folder / "net.onnx"), save_as_external_data=True, location="net.data",
        size_threshold=0,
    )  # fmt: skip
    return folder / "net.onnx"


def refer_to(path: Path, location: str) -> None:
    """Have a network read its weights elsewhere."""
    model = onnx.load(str(path), load_external_data=False)
    for entry in model.graph.initializer[0].external_data:
        if entry.key == "location":
            entry.value = location
    path.write_bytes(model.SerializeToString())


def test_weights_beside_a_network_are_read(tmp_path: Path) -> None:
    network = load_network(with_weights_beside(tmp_path / "net"))
    assert network.run(np.ones((1, 300), np.float32))[0].tolist() == [[300.0] * 3]


@each_case("where", ["../net.data", "{}/net.data", "a/../../net.data", "link"])
def test_weights_outside_the_folder_are_not_read(tmp_path: Path, where: str) -> None:
    path = with_weights_beside(tmp_path / "net")
    (tmp_path / "net" / "a").mkdir()
    os.replace(tmp_path / "net" / "net.data", tmp_path / "net.data")
    (tmp_path / "net" / "link").symlink_to(tmp_path / "net.data")
    refer_to(path, where.format(tmp_path))
    with pytest.raises(InputError, match=r"net\.onnx: weights: found the file .* in its folder"):
        load_network(path)


def test_missing_weights_are_named(tmp_path: Path) -> None:
    path = with_weights_beside(tmp_path / "net")
    (tmp_path / "net" / "net.data").unlink()
    with pytest.raises(InputError, match=r"found no file 'net\.data' beside it"):
        load_network(path)


def test_predictor_with_weights_in_other_files_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.onnx"
    onnx.save_model(
        onnx.load(str(SHIPPED)), str(path), save_as_external_data=True, location="mine.data",
        size_threshold=0,
    )  # fmt: skip
    with pytest.raises(InputError, match=r"mine\.onnx: found weights in other files.*onnx\.save"):
        make_predictor(str(path))
