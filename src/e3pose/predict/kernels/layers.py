"""Layers of a small network in single precision: products, LSTM cells and their curves.

A product is taken for four people and four inputs at a time: each weight is loaded once for the
four, and the innermost loop, over outputs, fills vector registers. Inputs are added one after
another, so that how many are taken at a time changes no digit.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.base.kernel import kernel
from e3pose.predict.kernels.half import Halves, widen

Floats32 = NDArray[np.float32]

# In single precision, as all that follow, so that products with them stay in it.
ZERO, HALF, ONE, TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
# Lambert's continued fraction y / (1 + y^2 / (3 + ... y^2 / 13)) of tanh y as y P(y^2) / Q(y^2).
P1, P2, P3 = np.float32(5 / 39), np.float32(2 / 715), np.float32(1 / 135135)
Q1, Q2, Q3 = np.float32(6 / 13), np.float32(10 / 429), np.float32(4 / 19305)
BLOCK = 4  # rows that products are taken for at a time
INPUTS = 4  # and inputs; three take a sixth longer, two a half, five a sixth
STEEPEST = np.float32(4.5)  # tanh of twice this is 1 in single precision


@kernel
def tanh(x: np.float32) -> np.float32:
    """Return tanh x = 2 t / (1 + t^2) with t = tanh(x / 2), within 2e-7."""
    y = min(max(HALF * x, -STEEPEST), STEEPEST)
    z = y * y
    p = y * (ONE + z * (P1 + z * (P2 + z * P3)))
    q = ONE + z * (Q1 + z * (Q2 + z * Q3))
    result: np.float32 = TWO * p * q / (q * q + p * p)
    return result


@kernel
def sigmoid(x: np.float32) -> np.float32:
    """Return the logistic function, within 1e-7."""
    result: np.float32 = HALF + HALF * tanh(HALF * x)
    return result


@kernel
def add_product(rows: Floats32, weight: Halves, out: Floats32) -> None:
    """Add `rows @ weight` to `out`.

    Args:
        rows: `(num_rows, num_inputs)`.
        weight: `(num_inputs, num_outputs)`.
        out: `(num_rows, num_outputs)`, added to.
    """
    whole = len(rows) - len(rows) % BLOCK
    for row in range(0, whole, BLOCK):
        _add_four(rows[row : row + BLOCK], weight, out[row : row + BLOCK])
    for row in range(whole, len(rows)):
        _add_one(rows[row], weight, out[row])


@kernel
def _add_four(rows: Floats32, weight: Halves, out: Floats32) -> None:
    a, b, c, d = out[0], out[1], out[2], out[3]
    num_inputs, num_outputs = weight.shape
    whole = num_inputs - num_inputs % INPUTS
    for k in range(0, whole, INPUTS):
        w0, w1, w2, w3 = weight[k], weight[k + 1], weight[k + 2], weight[k + 3]
        a0, a1, a2, a3 = rows[0, k], rows[0, k + 1], rows[0, k + 2], rows[0, k + 3]
        b0, b1, b2, b3 = rows[1, k], rows[1, k + 1], rows[1, k + 2], rows[1, k + 3]
        c0, c1, c2, c3 = rows[2, k], rows[2, k + 1], rows[2, k + 2], rows[2, k + 3]
        d0, d1, d2, d3 = rows[3, k], rows[3, k + 1], rows[3, k + 2], rows[3, k + 3]
        for j in range(num_outputs):
            u0, u1, u2, u3 = widen(w0[j]), widen(w1[j]), widen(w2[j]), widen(w3[j])
            a[j] = a[j] + a0 * u0 + a1 * u1 + a2 * u2 + a3 * u3
            b[j] = b[j] + b0 * u0 + b1 * u1 + b2 * u2 + b3 * u3
            c[j] = c[j] + c0 * u0 + c1 * u1 + c2 * u2 + c3 * u3
            d[j] = d[j] + d0 * u0 + d1 * u1 + d2 * u2 + d3 * u3
    for k in range(whole, num_inputs):
        for row in range(4):
            for j in range(num_outputs):
                out[row, j] += rows[row, k] * widen(weight[k, j])


@kernel
def _add_one(row: Floats32, weight: Halves, out: Floats32) -> None:
    num_inputs, num_outputs = weight.shape
    whole = num_inputs - num_inputs % INPUTS
    for k in range(0, whole, INPUTS):
        w0, w1, w2, w3 = weight[k], weight[k + 1], weight[k + 2], weight[k + 3]
        x0, x1, x2, x3 = row[k], row[k + 1], row[k + 2], row[k + 3]
        for j in range(num_outputs):
            part = out[j] + x0 * widen(w0[j]) + x1 * widen(w1[j])
            out[j] = part + x2 * widen(w2[j]) + x3 * widen(w3[j])
    for k in range(whole, num_inputs):
        for j in range(num_outputs):
            out[j] += row[k] * widen(weight[k, j])


@kernel
def linear(rows: Floats32, weight: Halves, bias: Floats32, out: Floats32) -> None:
    """Fill `out` with `rows @ weight + bias`, a linear layer."""
    for row in range(len(rows)):
        for j in range(len(bias)):
            out[row, j] = bias[j]
    add_product(rows, weight, out)


@kernel
def place_beside(rows: Floats32, column: int, out: Floats32) -> None:
    """Copy `rows` into the columns of `out` from `column` on."""
    for row in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            out[row, column + j] = rows[row, j]


@kernel
def rectify(values: Floats32) -> None:
    """Replace negative values `(num_rows, num_values)` by 0."""
    for row in range(values.shape[0]):
        for j in range(values.shape[1]):
            values[row, j] = max(values[row, j], ZERO)


@kernel
def soften(values: Floats32) -> None:
    """Replace `values` `(count,)` by their softmax."""
    most = values[0]
    for j in range(1, len(values)):
        most = max(most, values[j])
    total = ZERO
    for j in range(len(values)):
        values[j] = math.exp(values[j] - most)
        total += values[j]
    for j in range(len(values)):
        values[j] /= total


@kernel
def lstm_cell(gates: Floats32, hidden: Floats32, cell: Floats32) -> None:
    """Advance an LSTM, in place (Hochreiter and Schmidhuber, 1997).

    Args:
        gates: `(num_tracks, 4 * size)` input, output, forget and candidate, before their curves.
        hidden: `(num_tracks, size)`.
        cell: `(num_tracks, size)`.
    """
    size = cell.shape[1]
    for track in range(len(cell)):
        gate, own, out = gates[track], cell[track], hidden[track]
        for j in range(size):
            kept = sigmoid(gate[2 * size + j]) * own[j]
            own[j] = kept + sigmoid(gate[j]) * tanh(gate[3 * size + j])
        for j in range(size):
            out[j] = sigmoid(gate[size + j]) * tanh(own[j])
