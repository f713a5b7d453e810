"""Read the weights of the attention-LSTM from the ONNX file that holds them.

The network is run by own kernels (`kernels.network`); of ONNX only the file format is needed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.predict.kernels.half import in_half
from e3pose.predict.kernels.network import Weights
from e3pose.predict.normalise import NUM_COMMON, NUM_CONTEXT, NUM_FEATURES

Floats32 = NDArray[np.float32]

ATTENTION = 48  # outputs of the attentions
LEAST, MOST_HIDDEN, MOST_EXPERTS = 2, 4096, 1000
LOOK_HIDDEN, EXPERT, GATE = 2, 15, 17  # of the weights, those that tell the sizes of all
ELSEWHERE = (
    "found weights in other files, expected all in one: "
    "python -c \"import onnx; onnx.save(onnx.load('FILE.onnx'), 'ONE.onnx')\""
)
CONSTANT = (1,)  # the shape of those that the exporter writes between the weights
CONSTANTS = (NUM_COMMON, 0.01, 10, 1, 1, 1, 0.5, 0.002)
NO_MOTION = -30.0  # of the gate that keeps motion, in a network that says every displacement anew


@dataclass(frozen=True, slots=True, eq=False)
class WeightsFile:
    """The content of a file of weights.

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
    """Return the content of an ONNX file.

    Raises:
        InputError: when its weights are in other files, which may be anywhere.
        ValueError: for content that is no such file.
    """
    import onnx

    try:
        model = onnx.load_model_from_string(content)
    except Exception as error:  # protobuf raises kinds of its own
        raise ValueError(str(error)) from error
    graph = model.graph
    properties = {item.key: item.value for item in model.metadata_props}
    inputs, outputs = (tuple(one.name for one in part) for part in (graph.input, graph.output))
    # What is no text comes as bytes.
    if not all(isinstance(text, str) for text in (*properties.values(), *inputs, *outputs)):
        raise ValueError("a name that is no text")
    return WeightsFile(properties, inputs, outputs, tuple(tensors_of(graph)))


def tensors_of(graph: Any) -> Iterator[Floats32]:
    """Yield the floating-point weights of an `onnx.GraphProto`, then those of the graphs in it."""
    from onnx import AttributeProto, TensorProto, numpy_helper

    for tensor in graph.initializer:
        if tensor.data_location == TensorProto.EXTERNAL:
            raise InputError(ELSEWHERE)
        if tensor.data_type in (TensorProto.FLOAT, TensorProto.FLOAT16):
            yield np.atleast_1d(numpy_helper.to_array(tensor)).astype(np.float32)
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.type == AttributeProto.GRAPH:
                yield from tensors_of(attribute.g)


def network_weights(file: WeightsFile) -> Weights:
    """Return the weights as the kernels take them.

    Raises:
        ValueError: for another network than `e3pose_lab.train.export` writes.
    """
    if is_published(file):
        return _published(file)
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
    return _held([*some, *given])


def history_slots(file: WeightsFile) -> int:
    """Return the slots of history that the network takes; 0 where there is none."""
    if is_published(file):
        slots = file.properties.get("history_slots", "")
        return int(slots) if slots.isdecimal() and len(slots) < 6 else 0
    expert = file.tensors[EXPERT].shape if len(file.tensors) > EXPERT else (0,)
    return int(expert[0] // (3 * NUM_COMMON))


def is_published(file: WeightsFile) -> bool:
    """Tell whether the network is the paper's own, which states no errors."""
    return file.properties.get("states_error") == "no"


def _published(file: WeightsFile) -> Weights:
    """Return the weights of the paper's network, with nothing for the parts that it lacks.

    It is given places alone: what the kernels feed it besides meets zeros. It says by how many
    units of a person's speed joints move in a slot, as a decoder does that keeps no motion.
    """
    if file.properties.get("regressor") != "displacements":
        raise ValueError("a regressor of places instead of displacements")
    found = [tensor.shape for tensor in file.tensors]
    hidden = found[LOOK_HIDDEN + 2][0] if len(found) > LOOK_HIDDEN + 2 else 0
    if not LEAST <= hidden <= MOST_HIDDEN or found != _published_shapes(hidden):
        raise ValueError(f"{len(found)} weights of other shapes than the paper's network has")
    C, A, H = NUM_COMMON, ATTENTION, hidden
    slots = history_slots(file)
    weights = [tensor for tensor in file.tensors[2:] if tensor.shape != CONSTANT]
    attention, attention_bias, attention_hidden, weigh, weigh_bias = weights[:5]
    encoder, encoder_bias = _lstm(*weights[5:8])
    key, key_bias, entry_context, entry_bias, query, energy, entry = weights[8:15]
    decoder, decoder_bias = _lstm(*weights[15:18])
    read, read_bias, regress, regress_bias = weights[18:]
    attention[3 * C :] = 0
    encoder[3 * C : NUM_FEATURES + NUM_CONTEXT] = 0
    entry[3 * C : 6 * C] = 0
    regress = np.concatenate([regress, _none(H, C)], axis=1)
    regress_bias = np.concatenate([regress_bias, np.full(C, NO_MOTION, np.float32)])
    return _held([
        attention, attention_bias, attention_hidden, weigh, weigh_bias, encoder,
        encoder_bias, key, key_bias,
        _none(NUM_CONTEXT + H, 2 * (slots - 1) * C), _none(2 * (slots - 1) * C),
        _none(3 * C * slots, 6 * C), _none(6 * C), _none(NUM_CONTEXT + H, 1), _none(1),
        0 * entry_context, entry_bias, _none(NUM_CONTEXT, A), _none(A), query, energy, entry,
        decoder, decoder_bias, read, read_bias, regress, regress_bias,
        _none(2 * H, A), _none(A, C), _none(C), _none(6 * C, 3 * C),
    ])  # fmt: skip


def _held(parts: Sequence[Floats32]) -> Weights:
    """Return weights as the kernels take them: matrices in half precision, as training rounds them.

    A slot reads all of them, mostly from memory that other programs have used since the last one.
    """
    held: list[Any] = [
        in_half(part) if part.ndim == 2 else np.ascontiguousarray(part, dtype=np.float32)
        for part in parts
    ]
    return Weights(*held)


def _none(*shape: int) -> Floats32:
    return np.zeros(shape, np.float32)


def _published_shapes(hidden: int) -> list[tuple[int, ...]]:
    """Return the shapes of the paper's network in the order of the exporter."""
    C, A, H = NUM_COMMON, ATTENTION, hidden
    return [
        (NUM_FEATURES,), CONSTANT,
        (NUM_FEATURES, A), (A,), (H, A), (A, C), (C,), CONSTANT,
        (1, 4 * H, NUM_FEATURES + NUM_CONTEXT), (1, 4 * H, H), (1, 8 * H),
        (H, A), (A,), CONSTANT, (NUM_CONTEXT, H), (H,),
        (2 * H, A), (A, 1), (6 * C + H, H),
        (1, 4 * H, H), (1, 4 * H, H), (1, 8 * H),
        (2 * H, H), (H,), (H, 3 * C), (3 * C,), CONSTANT,
    ]  # fmt: skip


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
