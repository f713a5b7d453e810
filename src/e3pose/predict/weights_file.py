"""Read the weights of the attention-LSTM from the ONNX file that holds them.

The network is run by own kernels (`kernels.network`); of ONNX only the file format is needed.
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

ATTENTION = 48  # outputs of the attentions
LEAST, MOST_HIDDEN, MOST_EXPERTS = 2, 4096, 1000
LOOK_HIDDEN, EXPERT, GATE = 2, 15, 17  # of the weights, those that tell the sizes of all
CONSTANT = (1,)  # the shape of those that the exporter writes between the weights
CONSTANTS = (NUM_COMMON, 0.01, 10, 1, 1, 1, 0.5, 0.002)


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
        ValueError: for content that is no such file.
    """
    import onnx

    try:
        model = onnx.load_model_from_string(content)
    except Exception as error:  # protobuf raises kinds of its own
        raise ValueError(str(error)) from error
    graph = model.graph
    return WeightsFile(
        {item.key: item.value for item in model.metadata_props},
        tuple(one.name for one in graph.input),
        tuple(one.name for one in graph.output),
        tuple(tensors_of(graph)),
    )


def tensors_of(graph: Any) -> Iterator[Floats32]:
    """Yield the floating-point weights of an `onnx.GraphProto`, then those of the graphs in it."""
    from onnx import AttributeProto, TensorProto, numpy_helper

    for tensor in graph.initializer:
        if tensor.data_type in (TensorProto.FLOAT, TensorProto.FLOAT16):
            yield np.atleast_1d(numpy_helper.to_array(tensor)).astype(np.float32)
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.type == AttributeProto.GRAPH:
                yield from tensors_of(attribute.g)


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
