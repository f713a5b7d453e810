"""The attention-LSTM forward pass (paper section 3.2.1); weights are as the trainer writes them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from e3pose.base.kernel import kernel
from e3pose.predict.kernels.half import Halves, widen
from e3pose.predict.kernels.layers import (
    add_product,
    linear,
    lstm_cell,
    place_beside,
    rectify,
    sigmoid,
    soften,
    tanh,
)

Floats32 = NDArray[np.float32]

HUNDREDTH, TEN = np.float32(0.01), np.float32(10)


class Weights(NamedTuple):
    """All weights; matrices are `(inputs, outputs)` in half precision, gates as `lstm_cell` has.

    With `A` outputs of an attention, `H` the width of the LSTMs, `C` common joints, `M` slots of
    history and `E` experts.

    A network as published has zeros for the parts that it lacks, and a bias in `regress` that keeps
    no motion.
    """

    attention: Halves  # (7 C, A) input attention, of features
    attention_bias: Floats32  # (A,)
    attention_hidden: Halves  # (H, A) of the encoder's state
    weigh: Halves  # (A, C)
    weigh_bias: Floats32  # (C,)
    encoder: Halves  # (7 C + 4 + H, 4 H) of attended features, context and state
    encoder_bias: Floats32  # (4 H,)
    key: Halves  # (H, A) temporal attention
    key_bias: Floats32  # (A,)
    smooth: Halves  # (4 + H, 2 (M - 1) C)
    smooth_bias: Floats32
    expert: Halves  # (3 C M, 6 C E)
    expert_bias: Floats32
    gate: Halves  # (4 + H, E)
    gate_bias: Floats32
    entry_context: Halves  # (4, H)
    entry_bias: Floats32  # (H,)
    error_context: Halves  # (4, A)
    error_entry_bias: Floats32  # (A,)
    query: Halves  # (2 H, A)
    energy: Halves  # (A, 1)
    entry: Halves  # (6 C + H, H)
    decoder: Halves  # (2 H, 4 H) of entry and state
    decoder_bias: Floats32  # (4 H,)
    read: Halves  # (2 H, H)
    read_bias: Floats32  # (H,)
    regress: Halves  # (H, 4 C) changes of motion, and how much of it to keep
    regress_bias: Floats32  # (4 C,)
    error_hidden: Halves  # (2 H, A)
    error: Halves  # (A, C)
    error_bias: Floats32  # (C,)
    couple: Halves  # (6 C, 3 C)


@kernel
def run_network(
    weights: Weights,
    features: Floats32,
    context: Floats32,
    places: Floats32,
    log_error: Floats32,
) -> None:
    """Predict.

    Args:
        weights: of the network.
        features: `(M, num_tracks, 7 C)`, see `history.describe`.
        context: `(num_tracks, 4)`.
        places: `(num_leads, num_tracks, 3 C)`, filled: metres in the people's frames, all x before
            all y before all z.
        log_error: `(num_leads, num_tracks, C)`, filled: logarithm of the expected error; of a
            network as published it means nothing.
    """
    num_slots, num_tracks, _ = features.shape
    size, num_joints = len(weights.read_bias), len(weights.weigh_bias)
    hidden = np.zeros((num_tracks, size), np.float32)
    cell = np.zeros((num_tracks, size), np.float32)
    encoded = np.empty((num_slots, num_tracks, size), np.float32)
    _encode(weights, features, context, hidden, cell, encoded)
    keys = np.empty((num_slots * num_tracks, len(weights.key_bias)), np.float32)
    linear(encoded.reshape(-1, size), weights.key, weights.key_bias, keys)
    # Places and then motions, where the decoder starts.
    moving = np.empty((num_tracks, 6 * num_joints), np.float32)
    _start(weights, features, context, hidden, moving)
    entry = np.empty((num_tracks, size), np.float32)
    error_hidden = np.empty((num_tracks, len(weights.error_entry_bias)), np.float32)
    attended = np.empty((num_tracks, size), np.float32)
    for lead in range(len(places)):
        _attend(weights, hidden, cell, keys, encoded, attended)
        linear(context, weights.entry_context, weights.entry_bias, entry)
        linear(context, weights.error_context, weights.error_entry_bias, error_hidden)
        _decode(
            weights, context, attended, entry, error_hidden, hidden, cell, moving, log_error[lead]
        )
        for track in range(num_tracks):
            speed = HUNDREDTH * np.float32(math.exp(context[track, 0]))
            usual = math.log(0.002 + 0.5 * speed * (lead + 1))
            for joint in range(num_joints):
                log_error[lead, track, joint] += usual
            for axis in range(3 * num_joints):
                places[lead, track, axis] = moving[track, axis]


@kernel
def _encode(
    weights: Weights,
    features: Floats32,
    context: Floats32,
    hidden: Floats32,
    cell: Floats32,
    encoded: Floats32,
) -> None:
    """Read the slots one after another, each joint as the input attention weighs it."""
    num_slots, num_tracks, num_features = features.shape
    num_joints, num_context, size = len(weights.weigh_bias), context.shape[1], hidden.shape[1]
    width, width_in = len(weights.attention_bias), num_features + num_context
    all_scores = np.empty((num_slots * num_tracks, width), np.float32)
    linear(
        features.reshape(-1, num_features), weights.attention, weights.attention_bias, all_scores
    )
    shares = np.empty((num_tracks, num_joints), np.float32)
    entry = np.empty((num_tracks, width_in + size), np.float32)
    gates = np.empty((num_tracks, 4 * size), np.float32)
    for slot in range(num_slots):
        scores = all_scores[slot * num_tracks : (slot + 1) * num_tracks]
        if slot:  # the state is zero before the first
            add_product(hidden, weights.attention_hidden, scores)
        for track in range(num_tracks):
            row = scores[track]
            for j in range(width):
                row[j] = tanh(row[j])
        linear(scores, weights.weigh, weights.weigh_bias, shares)
        for track in range(num_tracks):
            soften(shares[track])
            for first in range(0, num_features, num_joints):
                for joint in range(num_joints):
                    share = np.float32(num_joints) * shares[track, joint]
                    entry[track, first + joint] = features[slot, track, first + joint] * share
        place_beside(context, num_features, entry)
        place_beside(hidden, width_in, entry)
        fed = width_in + size if slot else width_in
        linear(entry[:, :fed], weights.encoder[:fed], weights.encoder_bias, gates)
        lstm_cell(gates, hidden, cell)
        for track in range(num_tracks):
            for j in range(size):
                encoded[slot, track, j] = hidden[track, j]


@kernel
def _start(
    weights: Weights, features: Floats32, context: Floats32, hidden: Floats32, moving: Floats32
) -> None:
    """Fill the first places and motions `(num_tracks, 6 C)`: smoothed, and what experts find."""
    num_slots, num_tracks, _ = features.shape
    num_joints, num_context, size = len(weights.weigh_bias), context.shape[1], hidden.shape[1]
    axes, experts = 3 * num_joints, len(weights.gate_bias)
    summary = np.empty((num_tracks, num_context + size), np.float32)
    evidence = np.empty((num_tracks, axes * num_slots), np.float32)
    for track in range(num_tracks):
        speed = HUNDREDTH * np.float32(math.exp(context[track, 0]))
        for j in range(axes):
            evidence[track, j] = features[-1, track, j]
            for slot in range(1, num_slots):
                evidence[track, slot * axes + j] = TEN * speed * features[slot, track, axes + j]
    place_beside(context, 0, summary)
    place_beside(hidden, num_context, summary)
    kernels = np.empty((num_tracks, len(weights.smooth_bias)), np.float32)
    found = np.empty((num_tracks, len(weights.expert_bias)), np.float32)
    shares = np.empty((num_tracks, experts), np.float32)
    linear(summary, weights.smooth, weights.smooth_bias, kernels)
    linear(evidence, weights.expert, weights.expert_bias, found)
    linear(summary, weights.gate, weights.gate_bias, shares)
    half = (num_slots - 1) * num_joints
    for track in range(num_tracks):
        speed = HUNDREDTH * np.float32(math.exp(context[track, 0]))
        soften(shares[track])
        for j in range(axes):
            moving[track, j] = features[-1, track, j]
            moving[track, axes + j] = features[-1, track, axes + j]
        for slot in range(1, num_slots):
            for axis in range(3):
                for joint in range(num_joints):
                    at, j = (slot - 1) * num_joints + joint, axis * num_joints + joint
                    paced = features[slot, track, axes + j]
                    moving[track, j] += speed * kernels[track, half + at] * paced
                    moving[track, axes + j] += kernels[track, at] * paced
        for expert in range(experts):
            share, first = shares[track, expert], 2 * axes * expert
            for j in range(axes):
                moving[track, j] += share * found[track, first + j]
                moving[track, axes + j] += share * found[track, first + axes + j] / speed


@kernel
def _attend(
    weights: Weights,
    hidden: Floats32,
    cell: Floats32,
    keys: Floats32,
    encoded: Floats32,
    attended: Floats32,
) -> None:
    """Fill `attended` `(num_tracks, H)`: encoded slots by temporal attention."""
    num_slots, num_tracks, size = encoded.shape
    both = np.empty((num_tracks, 2 * size), np.float32)
    place_beside(hidden, 0, both)
    place_beside(cell, size, both)
    query = np.zeros((num_tracks, keys.shape[1]), np.float32)
    add_product(both, weights.query, query)
    share = np.empty(num_slots, np.float32)
    hidden = np.empty(keys.shape[1], np.float32)
    for track in range(num_tracks):
        for slot in range(num_slots):
            key = keys[slot * num_tracks + track]
            for j in range(len(hidden)):
                hidden[j] = tanh(key[j] + query[track, j])
            share[slot] = np.float32(0)
            for j in range(len(hidden)):
                share[slot] += hidden[j] * widen(weights.energy[j, 0])
        soften(share)
        for j in range(size):
            attended[track, j] = np.float32(0)
        for slot in range(num_slots):
            for j in range(size):
                attended[track, j] += share[slot] * encoded[slot, track, j]


@kernel
def _decode(
    weights: Weights,
    context: Floats32,
    attended: Floats32,
    entry: Floats32,
    error_hidden: Floats32,
    hidden: Floats32,
    cell: Floats32,
    moving: Floats32,
    error: Floats32,
) -> None:
    """Advance all tracks by one slot; `entry` and `error_hidden` hold what the context adds."""
    num_tracks, size = hidden.shape
    num_joints = len(weights.weigh_bias)
    axes = 3 * num_joints
    fed = np.empty((num_tracks, 2 * axes + size), np.float32)
    place_beside(moving, 0, fed)
    place_beside(attended, 2 * axes, fed)
    add_product(fed, weights.entry, entry)
    rectify(entry)
    both = np.empty((num_tracks, 2 * size), np.float32)
    place_beside(entry, 0, both)
    place_beside(hidden, size, both)
    gates = np.empty((num_tracks, 4 * size), np.float32)
    linear(both, weights.decoder, weights.decoder_bias, gates)
    lstm_cell(gates, hidden, cell)
    place_beside(hidden, 0, both)
    place_beside(attended, size, both)
    reading = np.empty((num_tracks, size), np.float32)
    linear(both, weights.read, weights.read_bias, reading)
    rectify(reading)
    result = np.empty((num_tracks, len(weights.regress_bias)), np.float32)
    linear(reading, weights.regress, weights.regress_bias, result)
    add_product(both, weights.error_hidden, error_hidden)
    rectify(error_hidden)
    linear(error_hidden, weights.error, weights.error_bias, error)
    coupled = np.zeros((num_tracks, axes), np.float32)
    add_product(moving, weights.couple, coupled)
    for track in range(num_tracks):
        speed = HUNDREDTH * np.float32(math.exp(context[track, 0]))
        for joint in range(num_joints):
            result[track, axes + joint] = sigmoid(result[track, axes + joint])
        for first in range(0, axes, num_joints):
            for joint in range(num_joints):
                j, kept = first + joint, result[track, axes + joint]
                motion = moving[track, axes + j] * kept + result[track, j] + coupled[track, j]
                moving[track, axes + j] = motion
                moving[track, j] += speed * motion
