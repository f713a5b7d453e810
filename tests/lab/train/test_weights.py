"""An exported network is taken up again exactly, and strangers' graphs are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: pip install e3pose[train]")
onnx = pytest.importorskip("onnx", reason="onnx is not installed: pip install e3pose[train]")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")

from e3pose.base.errors import InputError  # noqa: E402
from e3pose.predict.attention_lstm import SHIPPED  # noqa: E402
from e3pose_lab.train.export import export  # noqa: E402
from e3pose_lab.train.network import AttentionLstm, NetworkSettings  # noqa: E402
from e3pose_lab.train.weights import network_of  # noqa: E402


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def shaken(settings: NetworkSettings) -> AttentionLstm:
    torch.manual_seed(1)
    network = AttentionLstm(settings)
    network.eval()
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, 0, 0.1)
    return network


@pytest.mark.parametrize(("history_slots", "hidden"), [(4, 8), (10, 32)])
def test_every_weight_comes_back(history_slots: int, hidden: int) -> None:
    network = shaken(NetworkSettings(history_slots=history_slots, hidden=hidden, dropout=0.1))
    again, factors = network_of(export(network, [0.5, 1.5]), "here")
    assert again.settings == network.settings and factors == [0.5, 1.5]
    for name, value in network.state_dict().items():
        np.testing.assert_allclose(again.state_dict()[name], value, atol=1e-6, err_msg=name)


def test_the_shipped_weights_can_be_gone_on_from() -> None:
    network, factors = network_of(SHIPPED.read_bytes(), "shipped")
    assert network.settings.history_slots == 10 and len(factors) == 15


def test_strangers_are_refused(tmp_path: Path) -> None:
    good = export(shaken(NetworkSettings(history_slots=4, hidden=8)), [1.0])
    other = onnx.load_model_from_string(good)
    for node in other.graph.node:  # the same weights in a graph that says something else
        if node.op_type == "Tanh":
            node.op_type = "Sigmoid"
    bare = onnx.load_model_from_string(good)
    del bare.metadata_props[:]
    for content in (
        b"",
        b"nonsense",
        good[:-500],
        other.SerializeToString(),
        bare.SerializeToString(),
    ):
        with pytest.raises(InputError, match="here: found"):
            network_of(content, "here")
