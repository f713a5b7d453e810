"""Networks of LiteRT by a stand-in for its interpreter: what goes in, and what comes out."""

from __future__ import annotations

import sys
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from e3pose.base.errors import InputError
from e3pose.detectors.inference import load_network
from e3pose.detectors.movenet import MoveNet


class Interpreter:
    """Of ai-edge-litert 2.3: one input, one output."""

    signature = (1, -1, -1, 3)
    dtype: Any = np.uint8
    quantization = (0.0, 0)
    output: Any = np.zeros((1, 6, 56), np.float32)
    made: list[tuple[Any, Any]]
    fed: list[np.ndarray]

    def __init__(self, path: str, experimental_delegates: Any, num_threads: Any) -> None:
        if Path(path).read_bytes() != b"TFL3":
            raise ValueError("The model is not a valid Flatbuffer buffer")
        self.made.append((experimental_delegates, num_threads))
        self.shape, self.allocated = [1, 1, 1, 3], False

    def allocate_tensors(self) -> None:
        self.allocated = True

    def get_input_details(self) -> list[dict[str, Any]]:
        return [{"index": 0, "shape": np.array(self.shape), "dtype": self.dtype,
                 "shape_signature": np.array(self.signature)}]  # fmt: skip

    def get_output_details(self) -> list[dict[str, Any]]:
        return [{"index": 7, "name": "found", "quantization": self.quantization,
                 "shape_signature": np.array(self.output.shape)}]  # fmt: skip

    def resize_tensor_input(self, index: int, shape: tuple[int, ...]) -> None:
        if shape[1] % 32:
            raise RuntimeError("cannot reshape")
        self.shape, self.allocated = [*shape], False

    def set_tensor(self, index: int, tensor: np.ndarray) -> None:
        assert self.allocated and [*tensor.shape] == self.shape and tensor.dtype == self.dtype
        self.fed.append(tensor)

    def invoke(self) -> None: ...

    def get_tensor(self, index: int) -> Any:
        assert index == 7
        return self.output


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> type[Interpreter]:
    class Made(Interpreter):
        made, fed = [], []

    for name in ("ai_edge_litert", "ai_edge_litert.interpreter"):
        module = ModuleType(name)
        module.__spec__ = ModuleSpec(name, None)
        module.__dict__.update(Interpreter=Made, load_delegate=lambda name: f"delegate {name}")
        monkeypatch.setitem(sys.modules, name, module)
    (tmp_path / "net.tflite").write_bytes(b"TFL3")
    return Made


def test_movenet_runs_as_tflite(made: type[Interpreter], tmp_path: Path) -> None:
    row = np.zeros((1, 6, 56), np.float32)
    row[0, 0, :51] = np.tile((0.25, 0.5, 0.9), 17)
    row[0, 0, 55] = 0.8
    made.output = row
    detector = MoveNet(load_network(tmp_path / "net.tflite", threads=2, known=True))
    poses = detector.detect(np.full((480, 640, 3), 200, np.uint8))
    assert poses.keypoints_px[0, 3] == pytest.approx((319.5, 480 * 0.25 * 640 / 640 - 0.5), abs=9)
    assert made.made == [(None, 2)] and detector.provider == "litert"
    assert made.fed[0].dtype == np.uint8 and made.fed[0].max() == 200


def test_floats_are_fed_channels_first_and_quantised_outputs_are_floats(
    made: type[Interpreter], tmp_path: Path
) -> None:
    made.signature, made.dtype = (1, 32, 64, 3), np.float32
    made.output, made.quantization = np.full((1, 4), 130, np.uint8), (0.5, 128)
    network = load_network(tmp_path / "net.tflite", known=True)
    assert network.input_shape == (1, 3, 32, 64) and network.input_dtype == "float"
    image = np.arange(3 * 32 * 64, dtype=np.float32).reshape(1, 3, 32, 64)
    assert network.run(image)[0].tolist() == [[1.0] * 4]
    assert made.fed[0][0, 5, 7].tolist() == image[0, :, 5, 7].tolist()
    with pytest.raises(InputError, match="cannot reshape"):
        network.run(np.zeros((1, 3, 31, 64), np.float32))


def test_a_delegate_is_named_by_its_library(made: type[Interpreter], tmp_path: Path) -> None:
    load_network(tmp_path / "net.tflite", provider="libedgetpu.so.1", known=True)
    assert made.made == [(["delegate libedgetpu.so.1"], None)]
    with pytest.raises(InputError, match="'cuda', expected cpu, or a delegate"):
        load_network(tmp_path / "net.tflite", provider="cuda", known=True)


def test_what_is_no_network_and_a_missing_litert_are_said(
    made: type[Interpreter], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bad.tflite").write_bytes(b"PK")
    with pytest.raises(InputError, match="not a network LiteRT can load: The model is not"):
        load_network(tmp_path / "bad.tflite", known=True)
    monkeypatch.delitem(sys.modules, "ai_edge_litert")
    monkeypatch.setattr(sys, "path", [])
    with pytest.raises(InputError, match="not installed, expected `pip install"):
        load_network(tmp_path / "net.tflite")
