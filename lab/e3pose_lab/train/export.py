"""Write the network as one ONNX graph for any number of people and leads.

The graph is put together by hand: the encoder unrolled, the decoder as the body of one Loop, so
that it holds the fewest operations and every lead runs the same ones.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from e3pose.predict.attention_lstm import FORMAT, FORMAT_VERSION
from e3pose.predict.normalise import COMMON_JOINTS, NUM_COMMON, NUM_CONTEXT, NUM_FEATURES
from e3pose_lab.train.network import KEEP, NUM_AXES, AttentionLstm, NetworkSettings

OPSET = 17
HALF_FROM = 256  # numbers in a weight that half precision is worth it for
IR_VERSION = 8  # what ONNX Runtime 1.19 and newer read


class _Graph:
    """Nodes and weights of a graph in the making; every method returns the name of its result."""

    def __init__(self, prefix: str = "", half: bool = False) -> None:
        self.prefix, self.half = prefix, half
        self.nodes: list[onnx.NodeProto] = []
        self.weights: list[onnx.TensorProto] = []

    def constant(self, value: NDArray[np.generic]) -> str:
        name = f"{self.prefix}w{len(self.weights)}"
        value = np.ascontiguousarray(value)
        if self.half and value.dtype == np.float32 and value.size >= HALF_FROM:
            # ONNX Runtime folds the cast when it loads the graph: it costs nothing later.
            stored = f"{name}_half"
            self.nodes.append(helper.make_node("Cast", [stored], [name], to=TensorProto.FLOAT))
            self.weights.append(numpy_helper.from_array(value.astype(np.float16), stored))
        else:
            self.weights.append(numpy_helper.from_array(value, name))
        return name

    def integers(self, *values: int) -> str:
        return self.constant(np.array(values, dtype=np.int64))

    def add(self, kind: str, *inputs: str, **attributes: object) -> str:
        return self.add_all(kind, inputs, 1, **attributes)[0]

    def add_all(
        self, kind: str, inputs: Sequence[str], outputs: int, **attributes: object
    ) -> list[str]:
        names = [f"{self.prefix}n{len(self.nodes)}_{index}" for index in range(outputs)]
        self.nodes.append(helper.make_node(kind, list(inputs), names, **attributes))
        return names

    def linear(self, value: str, weight: NDArray[np.float32]) -> str:
        """Multiply by a torch weight `(out, in)`."""
        return self.add("MatMul", value, self.constant(weight.T))

    def lstm(
        self, value: str, hidden: str, cell: str, weights: Sequence[str], size: int
    ) -> list[str]:
        """Advance an LSTM by one slot; values are `(1, num_tracks, size)`."""
        inputs = [value, *weights, "", hidden, cell]
        return self.add_all("LSTM", inputs, 3, hidden_size=size)[1:]

    def lstm_weights(self, arrays: Mapping[str, NDArray[np.float32]], layer: str) -> list[str]:
        """Store a torch LSTM cell's weights in ONNX's order of gates."""

        def reordered(name: str) -> NDArray[np.float32]:
            i, f, g, o = np.split(arrays[f"{layer}.{name}"], 4)
            return np.concatenate([i, o, f, g])[None]

        bias = np.concatenate([reordered("bias_ih"), reordered("bias_hh")], axis=1)
        return [
            self.constant(reordered("weight_ih")),
            self.constant(reordered("weight_hh")),
            self.constant(bias),
        ]


def export(
    network: AttentionLstm,
    error_factor: Sequence[float],
    error_curve: NDArray[np.float64] | None = None,
    half: bool = False,
) -> bytes:
    """Return the network as a serialised ONNX model.

    `error_curve` and then `error_factor` calibrate the expected errors, see
    `predictors.calibration`. With `half` weights are stored in half precision; the network should
    have such weights already, see `halved`.

    Inputs: `features` and `context` as `normalise` makes them, and `num_leads` (one int64).
    Outputs: `places` `(num_leads, num_tracks, 3 * NUM_COMMON)` metres in the people's frames, all x
    before all y before all z, and `log_error` `(num_leads, num_tracks, NUM_COMMON)`.
    """
    arrays = {
        name: value.detach().cpu().numpy().astype(np.float32)
        for name, value in network.state_dict().items()
    }
    sizes = network.settings
    slots = sizes.history_slots
    graph = _Graph(half=half)
    state, memory = _encoder(graph, arrays, sizes)
    body = _decoder(arrays, memory, sizes, half)
    trips = graph.add("Squeeze", "num_leads", graph.integers(0))
    keep_going = graph.constant(np.array([True]))
    results = graph.add_all("Loop", [trips, keep_going, *state], len(state) + 2, body=body)
    graph.nodes.append(helper.make_node("Squeeze", [results[-2], graph.integers(1)], ["places"]))
    error = graph.add("Squeeze", results[-1], graph.integers(1))
    _add_log_error(graph, error, trips, memory["speed"] if sizes.moves else None)

    def value(name: str, *shape: str | int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

    model = helper.make_model(
        helper.make_graph(
            graph.nodes,
            "attention_lstm",
            [
                value("features", slots, "num_tracks", NUM_FEATURES),
                value("context", "num_tracks", NUM_CONTEXT),
                helper.make_tensor_value_info("num_leads", TensorProto.INT64, [1]),
            ],
            [
                value("places", "num_leads", "num_tracks", NUM_AXES),
                value("log_error", "num_leads", "num_tracks", NUM_COMMON),
            ],
            graph.weights,
        ),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="e3pose",
    )
    helper.set_model_props(
        model,
        {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "history_slots": str(slots),
            "settings": json.dumps(asdict(network.settings)),
            "joints": " ".join(COMMON_JOINTS),
            "states_error": "yes" if network.settings.moves else "no",
            "regressor": "displacements" if network.settings.displaces else "places",
            "error_factor": json.dumps([round(float(factor), 4) for factor in error_factor]),
            "error_curve": json.dumps(None if error_curve is None else _rising(error_curve)),
        },
    )
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


def _add_log_error(graph: _Graph, error: str, trips: str, speed: str | None) -> None:
    """Add the last output: errors on the scale of the speed, or as they are without one."""
    if speed is None:
        graph.nodes.append(helper.make_node("Identity", [error], ["log_error"]))
        return
    lead = graph.add(
        "Range", graph.constant(np.float32(1)),
        graph.add("Add", graph.add("Cast", trips, to=TensorProto.FLOAT),
                  graph.constant(np.float32(1))),
        graph.constant(np.float32(1)),
    )  # fmt: skip
    lead = graph.add("Unsqueeze", lead, graph.integers(1, 2))
    usual = graph.add("Mul", graph.add("Mul", speed, lead), graph.constant(np.float32(0.5)))
    usual = graph.add("Log", graph.add("Add", usual, graph.constant(np.float32(0.002))))
    graph.nodes.append(helper.make_node("Add", [error, usual], ["log_error"]))


def halved(network: AttentionLstm) -> None:
    """Round the weights of a network to what half precision holds."""
    for parameter in network.parameters():
        parameter.data = parameter.data.half().float()


def _rising(curve: NDArray[np.float64]) -> list[object]:
    """Return a calibration curve in few digits that still rises."""
    digits = np.round(curve, 3)
    steps = 0.001 * np.arange(curve.shape[-1])
    digits[0] = np.maximum.accumulate(digits[0] - steps, axis=-1) + steps
    return list(np.round(digits, 3).tolist())


def _encoder(
    graph: _Graph, arrays: Mapping[str, NDArray[np.float32]], sizes: NetworkSettings
) -> tuple[list[str], dict[str, str]]:
    """Add the encoder; return the decoder's first state and what it looks at in every step."""
    slots, hidden = sizes.history_slots, sizes.hidden
    features = "features"
    given = context = graph.add("Unsqueeze", "context", graph.integers(0))
    if not sizes.context:
        mask = (np.arange(NUM_FEATURES) < NUM_AXES).astype(np.float32)
        features = graph.add("Mul", features, graph.constant(mask))
        context = graph.add("Mul", context, graph.constant(np.float32(0)))
    from_input, from_hidden = np.split(arrays["input_attention.0.weight"], [NUM_FEATURES], axis=1)
    scores = graph.add(
        "Add",
        graph.linear(features, from_input),
        graph.constant(arrays["input_attention.0.bias"]),
    )
    scores_at = graph.add_all("Split", [scores, graph.integers(*[1] * slots)], slots, axis=0)
    features_at = graph.add_all("Split", [features, graph.integers(*[1] * slots)], slots, axis=0)
    hidden_weight = graph.constant(from_hidden.T)
    out_weight = graph.constant(arrays["input_attention.2.weight"].T)
    out_bias = graph.constant(arrays["input_attention.2.bias"])
    tiles = graph.integers(1, 1, 7)
    number = graph.constant(np.float32(NUM_COMMON))
    weights = graph.lstm_weights(arrays, "encoder")
    tracks = graph.add("Shape", "context", start=0, end=1)
    blank = graph.add("Concat", graph.integers(1), tracks, graph.integers(hidden), axis=0)
    state = cell = graph.add("ConstantOfShape", blank)
    encoded = []
    for slot in range(slots):
        score = graph.add("Add", scores_at[slot], graph.add("MatMul", state, hidden_weight))
        score = graph.add("MatMul", graph.add("Tanh", score), out_weight)
        weight = graph.add("Softmax", graph.add("Add", score, out_bias), axis=-1)
        weight = graph.add("Tile", graph.add("Mul", weight, number), tiles)
        chosen = graph.add("Mul", features_at[slot], weight)
        chosen = graph.add("Concat", chosen, context, axis=-1)
        state, cell = graph.lstm(chosen, state, cell, weights, hidden)
        encoded.append(state)
    stacked = graph.add("Concat", *encoded, axis=0)
    keys = graph.add(
        "Add", graph.linear(stacked, arrays["key.weight"]), graph.constant(arrays["query.bias"])
    )
    log_speed = graph.add("Slice", given, graph.integers(0), graph.integers(1), graph.integers(2))
    speed = graph.add("Mul", graph.add("Exp", log_speed), graph.constant(np.float32(0.01)))
    motions = graph.add(
        "Slice", features, graph.integers(1, NUM_AXES), graph.integers(slots, 2 * NUM_AXES),
        graph.integers(0, 2),
    )  # fmt: skip
    parts = [NUM_AXES, NUM_AXES, NUM_COMMON]
    place, motion, _ = graph.add_all("Split", [features_at[-1], graph.integers(*parts)], 3, axis=-1)
    start = (place, motion)
    summary = graph.add("Concat", context, state, axis=-1)
    if sizes.smooths:
        start = _smoothed(graph, arrays, slots, start, motions, summary, speed)
    if sizes.experts:
        start = _with_experts(graph, arrays, slots, start, place, motions, summary, speed)
    entry_context = graph.linear(context, arrays["entry.weight"][:, -NUM_CONTEXT:])
    entry_context = graph.add("Add", entry_context, graph.constant(arrays["entry.bias"]))
    memory = {"encoded": stacked, "keys": keys, "entry": entry_context, "speed": speed}
    if sizes.moves:
        doubt = graph.linear(context, arrays["doubt.weight"][:, -NUM_CONTEXT:])
        memory["doubt"] = graph.add("Add", doubt, graph.constant(arrays["doubt.bias"]))
    return [state, cell, *start], memory


def _smoothed(
    graph: _Graph,
    arrays: Mapping[str, NDArray[np.float32]],
    slots: int,
    start: tuple[str, str],
    motions: str,
    summary: str,
    speed: str,
) -> tuple[str, str]:
    """Return places and motions smoothed over the history, with weights of the encoder's."""
    weights = graph.linear(summary, arrays["smoothing.weight"])
    weights = graph.add("Add", weights, graph.constant(arrays["smoothing.bias"]))
    weights = graph.add("Reshape", weights, graph.integers(-1, 2, slots - 1, NUM_COMMON))
    weights = graph.add("Transpose", weights, perm=[1, 2, 0, 3])
    weights = graph.add("Tile", weights, graph.integers(1, 1, 1, 3))
    sums = graph.add("ReduceSum", graph.add("Mul", weights, motions), graph.integers(1), keepdims=0)
    change, offset = graph.add_all("Split", [sums, graph.integers(1, 1)], 2, axis=0)
    place, motion = start
    return graph.add("Add", place, graph.add("Mul", speed, offset)), graph.add(
        "Add", motion, change
    )


def _with_experts(
    graph: _Graph,
    arrays: Mapping[str, NDArray[np.float32]],
    slots: int,
    start: tuple[str, str],
    newest: str,
    motions: str,
    summary: str,
    speed: str,
) -> tuple[str, str]:
    """Return places and motions with what the experts find added."""
    read = graph.add("Mul", motions, graph.add("Mul", speed, graph.constant(np.float32(10))))
    read = graph.add("Transpose", read, perm=[1, 0, 2])
    read = graph.add("Reshape", read, graph.integers(0, (slots - 1) * NUM_AXES))
    flat = graph.add("Squeeze", newest, graph.integers(0))
    read = graph.add("Concat", flat, read, axis=-1)
    found = graph.linear(read, arrays["expert.weight"])
    found = graph.add("Add", found, graph.constant(arrays["expert.bias"]))
    found = graph.add("Reshape", found, graph.integers(0, -1, 2 * NUM_AXES))
    share = graph.linear(summary, arrays["gate.weight"])
    share = graph.add("Add", share, graph.constant(arrays["gate.bias"]))
    share = graph.add("Transpose", graph.add("Softmax", share, axis=-1), perm=[1, 2, 0])
    found = graph.add("Mul", found, share)
    found = graph.add("ReduceSum", found, graph.integers(1), keepdims=0)
    found = graph.add("Unsqueeze", found, graph.integers(0))
    fix, push = graph.add_all("Split", [found, graph.integers(NUM_AXES, NUM_AXES)], 2, axis=-1)
    place, motion = start
    return graph.add("Add", place, fix), graph.add("Add", motion, graph.add("Div", push, speed))


def _decoder(
    arrays: Mapping[str, NDArray[np.float32]],
    memory: Mapping[str, str],
    sizes: NetworkSettings,
    half: bool,
) -> onnx.GraphProto:
    """Return the decoder's step as the body of a Loop."""
    graph, hidden = _Graph("step_", half), sizes.hidden
    state, cell, place, motion = "state", "cell", "place", "motion"
    query = graph.add("Concat", state, cell, axis=-1)
    query = graph.linear(query, arrays["query.weight"])
    energy = graph.add("Tanh", graph.add("Add", memory["keys"], query))
    weight = graph.add("Softmax", graph.linear(energy, arrays["energy.weight"]), axis=0)
    attended = graph.add("Mul", weight, memory["encoded"])
    attended = graph.add("ReduceSum", attended, graph.integers(0))
    where = graph.add("Concat", place, motion, axis=-1)
    entry = graph.add("Concat", where, attended, axis=-1)
    entry = graph.linear(entry, arrays["entry.weight"][:, :-NUM_CONTEXT])
    entry = graph.add("Relu", graph.add("Add", entry, memory["entry"]))
    state, cell = graph.lstm(entry, state, cell, graph.lstm_weights(arrays, "decoder"), hidden)
    known = graph.add("Concat", state, attended, axis=-1)
    reading = graph.linear(known, arrays["reading.weight"])
    reading = graph.add("Add", reading, graph.constant(arrays["reading.bias"]))
    reading = graph.add("Relu", reading)
    if sizes.moves:
        place, motion, error = _moved(graph, arrays, memory, (place, motion), where, known, reading)
    else:
        said = graph.linear(reading, arrays["regressor.weight"])
        said = graph.add("Add", said, graph.constant(arrays["regressor.bias"]))
        if sizes.displaces:
            place = graph.add("Add", place, graph.add("Mul", memory["speed"], said))
        else:
            place = graph.add("Identity", said)
        error = graph.add(
            "Slice", said, graph.integers(0), graph.integers(NUM_COMMON), graph.integers(2)
        )
        error = graph.add("Mul", error, graph.constant(np.float32(0)))
        motion = graph.add("Identity", motion)
    places = graph.add("Identity", place)
    going = graph.add("Identity", "going")

    def value(name: str, size: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, "num_tracks", size])

    widths = {"state": hidden, "cell": hidden, "place": NUM_AXES, "motion": NUM_AXES}
    inputs = [
        helper.make_tensor_value_info("lead", TensorProto.INT64, [1]),
        helper.make_tensor_value_info("going", TensorProto.BOOL, [1]),
        *(value(name, size) for name, size in widths.items()),
    ]
    outputs = [
        helper.make_tensor_value_info(going, TensorProto.BOOL, [1]),
        *(value(n, s) for n, s in zip((state, cell, place, motion), widths.values(), strict=True)),
        value(places, NUM_AXES),
        value(error, NUM_COMMON),
    ]
    return helper.make_graph(graph.nodes, "decoder_step", inputs, outputs, graph.weights)


def _moved(
    graph: _Graph,
    arrays: Mapping[str, NDArray[np.float32]],
    memory: Mapping[str, str],
    start: tuple[str, str],
    where: str,
    known: str,
    reading: str,
) -> tuple[str, str, str]:
    """Return places and motions one lead further, and how far off these places may be."""
    place, motion = start
    bias = arrays["regressor.bias"].copy()
    bias[NUM_AXES:] += KEEP
    result = graph.linear(reading, arrays["regressor.weight"])
    result = graph.add("Add", result, graph.constant(bias))
    parts = graph.integers(NUM_AXES, NUM_COMMON)
    change, keep = graph.add_all("Split", [result, parts], 2, axis=-1)
    doubt = graph.linear(known, arrays["doubt.weight"][:, :-NUM_CONTEXT])
    doubt = graph.add("Relu", graph.add("Add", doubt, memory["doubt"]))
    error = graph.linear(doubt, arrays["error.weight"])
    error = graph.add("Add", error, graph.constant(arrays["error.bias"]))
    change = graph.add("Add", change, graph.linear(where, arrays["coupling.weight"]))
    keep = graph.add("Tile", graph.add("Sigmoid", keep), graph.integers(1, 1, 3))
    motion = graph.add("Add", graph.add("Mul", motion, keep), change)
    return graph.add("Add", place, graph.add("Mul", memory["speed"], motion)), motion, error
