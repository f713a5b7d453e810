"""Read the weights of the attention-LSTM from the ONNX file that holds them.

The network is run by own kernels (`kernels.network`), so nothing is needed of ONNX but what its
files hold: protocol buffers of a few kinds. Fields have the numbers of `onnx.proto`, version 3.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.predict.kernels.network import Weights
from e3pose.predict.normalise import NUM_COMMON, NUM_CONTEXT, NUM_FEATURES

Floats32 = NDArray[np.float32]
Field = tuple[int, int | bytes]

ATTENTION = 48  # outputs of the attentions
LEAST, MOST_HIDDEN, MOST_EXPERTS = 2, 4096, 1000
LOOK_HIDDEN, EXPERT, GATE = 2, 15, 17  # of the weights, those that tell the sizes of all
CONSTANT = (1,)  # the shape of those that the exporter writes between the weights
CONSTANTS = (NUM_COMMON, 0.01, 10, 1, 1, 1, 0.5, 0.002)
VARINT, DOUBLE, BYTES, SINGLE = 0, 1, 2, 5  # wire types of protocol buffers
# Field numbers.
MODEL_GRAPH, MODEL_PROPERTY = 7, 14
GRAPH_NODE, GRAPH_WEIGHT, GRAPH_INPUT, GRAPH_OUTPUT = 1, 5, 11, 12
NODE_ATTRIBUTE, ATTRIBUTE_GRAPH, VALUE_NAME = 5, 6, 1
TENSOR_SHAPE, TENSOR_TYPE, TENSOR_CONTENT = 1, 2, 9
PROPERTY_KEY, PROPERTY_VALUE = 1, 2
TYPES: dict[int, np.dtype[Any]] = {1: np.dtype("<f4"), 10: np.dtype("<f2")}


@dataclass(frozen=True, slots=True, eq=False)
class WeightsFile:
    """What a file of weights holds.

    Attributes:
        properties: the texts beside the network.
        inputs: their names.
        outputs: their names.
        tensors: all floating-point constants, in the file's order.
    """

    properties: dict[str, str]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    tensors: tuple[Floats32, ...]


def read_file(content: bytes) -> WeightsFile:
    """Return what an ONNX file holds.

    Raises:
        ValueError: for content that is no such file; also UnicodeDecodeError, which is one.
    """
    properties: dict[str, str] = {}
    graph = b""
    for number, value in _fields(content):
        if number == MODEL_GRAPH:
            graph = _bytes(value)
        elif number == MODEL_PROPERTY:
            pair = dict(_fields(_bytes(value)))
            key, text = (_bytes(pair.get(n, b"")) for n in (PROPERTY_KEY, PROPERTY_VALUE))
            properties[key.decode()] = text.decode()
    names: dict[int, list[str]] = {GRAPH_INPUT: [], GRAPH_OUTPUT: []}
    for number, value in _fields(graph):
        if number in names:
            names[number].append(_bytes(dict(_fields(_bytes(value)))[VALUE_NAME]).decode())
    return WeightsFile(
        properties, tuple(names[GRAPH_INPUT]), tuple(names[GRAPH_OUTPUT]), tuple(_tensors(graph))
    )


def network_weights(file: WeightsFile) -> Weights:
    """Return the weights as the kernels take them.

    Raises:
        ValueError: for another network than `e3pose.learn.train.export` writes.
    """
    found = [tensor.shape for tensor in file.tensors]
    if len(found) <= GATE:
        raise ValueError(f"{len(found)} weights")
    hidden, experts = found[LOOK_HIDDEN][0], found[GATE][-1]
    if not (LEAST <= hidden <= MOST_HIDDEN and LEAST <= experts <= MOST_EXPERTS):
        raise ValueError(f"{hidden} hidden units and {experts} experts")
    shapes = _shapes(history_slots(file), hidden, experts)
    if found != shapes:
        raise ValueError(f"{len(found)} weights of other shapes than the {len(shapes)} expected")
    constants = [float(tensor[0]) for tensor in file.tensors if tensor.shape == (1,)]
    if constants[: len(CONSTANTS)] != [float(np.float32(value)) for value in CONSTANTS]:
        raise ValueError("other constants than expected")
    given = (t for t, shape in zip(file.tensors, shapes, strict=True) if shape != CONSTANT)
    some = [next(given) for _ in range(5)]
    encoder = _lstm(next(given), next(given), next(given))
    some += [*encoder, *(next(given) for _ in range(15))]
    some += _lstm(next(given), next(given), next(given))
    return Weights(*(np.ascontiguousarray(tensor) for tensor in (*some, *given)))


def history_slots(file: WeightsFile) -> int:
    """Return the slots of history that the network takes; 0 where there is none."""
    expert = file.tensors[EXPERT].shape if len(file.tensors) > EXPERT else (0,)
    return int(expert[0] // (3 * NUM_COMMON))


def _lstm(entry: Floats32, state: Floats32, bias: Floats32) -> tuple[Floats32, Floats32]:
    """Return one matrix for entry and state, and the bias, of the weights of ONNX's LSTM."""
    both = np.concatenate([entry[0].T, state[0].T])
    return both, np.asarray(np.split(bias[0], 2), dtype=np.float32).sum(axis=0)


def _shapes(slots: int, hidden: int, experts: int) -> list[tuple[int, ...]]:
    """Return the shapes of the weights in the order of the exporter."""
    C, A, H = NUM_COMMON, ATTENTION, hidden
    fed = NUM_FEATURES + NUM_CONTEXT
    return [
        (NUM_FEATURES, A), (A,), (H, A), (A, C), (C,), CONSTANT,
        (1, 4 * H, fed), (1, 4 * H, H), (1, 8 * H),
        (H, A), (A,), CONSTANT,
        (NUM_CONTEXT + H, 2 * (slots - 1) * C), (2 * (slots - 1) * C,), CONSTANT,
        (3 * C * slots, 6 * C * experts), (6 * C * experts,),
        (NUM_CONTEXT + H, experts), (experts,),
        (NUM_CONTEXT, H), (H,), (NUM_CONTEXT, A), (A,), *[CONSTANT] * 5,
        (2 * H, A), (A, 1), (6 * C + H, H),
        (1, 4 * H, H), (1, 4 * H, H), (1, 8 * H),
        (2 * H, H), (H,), (H, 4 * C), (4 * C,),
        (2 * H, A), (A, C), (C,), (6 * C, 3 * C),
    ]  # fmt: skip


def _tensors(graph: bytes) -> Iterator[Floats32]:
    """Yield the weights of a graph, then those of the graphs in its nodes."""
    for number, value in _fields(graph):
        if number == GRAPH_WEIGHT:
            shape = [int(v) for n, v in _fields(_bytes(value)) if n == TENSOR_SHAPE]
            rest = dict(_fields(_bytes(value)))
            form = TYPES.get(int(rest.get(TENSOR_TYPE, 0)))
            if form is not None:
                numbers: NDArray[Any] = np.frombuffer(_bytes(rest[TENSOR_CONTENT]), form)
                yield numbers.reshape(shape or CONSTANT).astype(np.float32)
    for number, value in _fields(graph):
        if number == GRAPH_NODE:
            for kind, attribute in _fields(_bytes(value)):
                if kind == NODE_ATTRIBUTE:
                    inner = dict(_fields(_bytes(attribute))).get(ATTRIBUTE_GRAPH)
                    if inner is not None:
                        yield from _tensors(_bytes(inner))


def _fields(content: bytes) -> Iterator[Field]:
    """Yield the numbers and values of the fields of a protocol buffer."""
    at = 0
    while at < len(content):
        tag, at = _varint(content, at)
        kind = tag & 7
        if kind == VARINT:
            value, at = _varint(content, at)
            yield tag >> 3, value
            continue
        size = {DOUBLE: 8, SINGLE: 4}.get(kind, -1)
        if kind == BYTES:
            size, at = _varint(content, at)
        if size < 0 or at + size > len(content):
            raise ValueError("no protocol buffer")
        yield tag >> 3, content[at : at + size]
        at += size


def _varint(content: bytes, at: int) -> tuple[int, int]:
    value, shift = 0, 0
    while at < len(content) and shift < 64:
        byte = content[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at
    raise ValueError("no protocol buffer")


def _bytes(value: int | bytes) -> bytes:
    if isinstance(value, int):
        raise ValueError("no protocol buffer")
    return value
