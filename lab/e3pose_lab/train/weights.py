"""ONNX -> torch: take a network up again that was exported, so that training goes on from there.

The exporter only moves weights about, and adds constants to some. Networks whose weights are
numbered are exported to see where each goes; so this needs no knowledge of the graph, and follows
the exporter when that changes. Nothing is unpickled.
"""

from __future__ import annotations

import json
from dataclasses import fields
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.predict.normalise import NUM_CONTEXT, NUM_FEATURES
from e3pose.predict.weights_file import tensors_of
from e3pose_lab.train.export import export
from e3pose_lab.train.network import AttentionLstm, NetworkSettings

Singles = NDArray[np.float32]

DIGIT = 1000  # numbers are marked digit by digit, so that float16 holds each exactly
TOLERANCE = 1e-3  # half precision is good for three digits


def network_of(content: bytes, where: str) -> tuple[AttentionLstm, list[float]]:
    """Return the network in an exported graph, and its factors of expected errors.

    Args:
        content: ONNX, as `export` writes it.
        where: names it in errors.

    Raises:
        InputError: when it is no such graph, or comes from an exporter of another kind.
    """
    try:
        model = onnx.load_model_from_string(content)
        properties = {item.key: item.value for item in model.metadata_props}
        factors = [float(factor) for factor in json.loads(properties["error_factor"])]
        network = AttentionLstm(_settings(model, properties)).eval()
        targets = list(tensors_of(model.graph))
        names = list(network.state_dict())
        flat = _flat(network, names)
        if len(flat) >= DIGIT**2:
            raise ValueError(f"{len(flat)} weights")
    except Exception as error:  # protobuf and torch raise many kinds for damaged files
        raise InputError(f"{where}: found no network to go on from ({error})") from error
    values = np.full(len(flat), np.nan, np.float32)
    number = np.arange(1, len(flat) + 1)  # 0 marks constants
    marks = [np.zeros(len(flat)), number % DIGIT, number // DIGIT]
    blank, low, high = (_exported(network, names, mark) for mark in marks)
    if [a.shape for a in blank] != [t.shape for t in targets]:
        raise InputError(f"{where}: found another kind of graph than e3pose exports")
    for constant, low_digit, high_digit, target in zip(blank, low, high, targets, strict=True):
        index = np.rint(low_digit - constant) + DIGIT * np.rint(high_digit - constant)
        known = index > 0
        values[index[known].astype(np.int64) - 1] = (target - constant)[known]
    _load(network, names, values)
    if not np.isfinite(values).all() or not _same(network, factors, content):
        raise InputError(f"{where}: found another kind of graph than e3pose exports")
    return network, factors


def _settings(model: Any, properties: dict[str, str]) -> NetworkSettings:
    if "settings" in properties:
        known = {field.name for field in fields(NetworkSettings)}
        stored = json.loads(properties["settings"])
        return NetworkSettings(**{key: value for key, value in stored.items() if key in known})
    (hidden,) = {
        attribute.i
        for node in model.graph.node
        for attribute in node.attribute
        if node.op_type == "LSTM" and attribute.name == "hidden_size"
    }
    return NetworkSettings(history_slots=int(properties["history_slots"]), hidden=int(hidden))


def _flat(network: AttentionLstm, names: list[str]) -> Singles:
    state = network.state_dict()
    return np.concatenate([state[name].numpy().ravel() for name in names])


def _load(network: AttentionLstm, names: list[str], values: NDArray[Any]) -> None:
    state, start = network.state_dict(), 0
    for name in names:
        size = state[name].numel()
        part = torch.from_numpy(values[start : start + size].astype(np.float32))
        state[name] = part.reshape(state[name].shape)
        start += size
    network.load_state_dict(state)


def _exported(network: AttentionLstm, names: list[str], values: NDArray[Any]) -> list[Singles]:
    _load(network, names, values)
    return list(tensors_of(onnx.load_model_from_string(export(network, [1.0])).graph))


def _same(network: AttentionLstm, factors: list[float], content: bytes) -> bool:
    """Tell whether the network says what the graph says."""
    import onnxruntime as ort

    rng = np.random.default_rng(0)
    features = rng.normal(size=(network.settings.history_slots, 3, NUM_FEATURES))
    inputs = {
        "features": features.astype(np.float32),
        "context": rng.normal(size=(3, NUM_CONTEXT)).astype(np.float32),
        "num_leads": np.array([5]),
    }
    said = [
        ort.InferenceSession(graph, providers=["CPUExecutionProvider"]).run(None, inputs)
        for graph in (content, export(network, factors))
    ]
    return all(
        np.allclose(first, second, rtol=TOLERANCE, atol=TOLERANCE)
        for first, second in zip(*said, strict=True)
    )
