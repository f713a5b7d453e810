"""Biases of views: the loops of `filter.update.learn_biases` and `filter.bias`, for one track."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.filter.bias import LEARNED_S, SHORTEST_S, MemoryTerms
from e3pose.estimate.filter.kernels.projected import beside
from e3pose.estimate.filter.outliers import MEASURED_SIGMAS
from e3pose.runtime.kernel import kernel

Floats = NDArray[np.float64]


@kernel
def inflation(since_s: float, terms: MemoryTerms) -> float:
    """Return the factor on a keypoint's variance so long after the look before."""
    since_s = SHORTEST_S if since_s < SHORTEST_S else since_s
    since_s = terms.lasting_s if since_s > terms.lasting_s else since_s
    return terms.fresh + terms.quick / math.tanh(since_s / (2 * terms.quick_s))


@kernel
def worth_inflation(since_s: float, terms: MemoryTerms) -> float:
    """Return the factor by which a selector counts a keypoint's variance, see `MemoryTerms`."""
    repeated = math.tanh(max(since_s, SHORTEST_S) / (2 * terms.lasting_s))
    return inflation(since_s, terms) + terms.unlearned / repeated


@kernel
def left_over(since_s: float, terms: MemoryTerms) -> float:
    """Return the share of a keypoint's variance that its learned bias does not remove."""
    return 1.0 - terms.removed * math.exp(-2.0 * since_s / terms.lasting_s)


@kernel
def learn_bias(
    row: int,
    since_s: float,
    terms: MemoryTerms,
    state: Floats,
    covariance: Floats,
    projection: Floats,
    pixels: Floats,
    weights: Floats,
    variances: Floats,
    bias_px: Floats,
) -> None:
    """Compare the detection in `row` with the updated track that it is of.

    Args:
        row: of the detection in `pixels`, `weights` and `variances`.
        since_s: seconds since the view saw the person before; inf if never.
        terms: how long errors last.
        state: `(num_joints, 6)`.
        covariance: `(num_joints, 6, 6)`.
        projection: `(3, 4)`.
        pixels: `(num_rows, num_joints, 2)`.
        weights: `(num_rows, num_joints)`.
        variances: `(num_rows, num_joints)`.
        bias_px: `(num_joints, 2)`, of this view, moved.
    """
    rate = 1.0 - math.exp(-since_s / LEARNED_S)
    rate = rate if rate < terms.most else terms.most
    for joint in range(len(state)):
        known, du, dv, variance_px2, _, _, _, _, _, _ = beside(
            row, joint, state, covariance, projection, pixels, weights, bias_px
        )
        if not known:
            continue
        variance = variances[row, joint]
        off = math.sqrt((du * du + dv * dv) / variance) / MEASURED_SIGMAS
        blame = rate * variance / (variance + variance_px2) / (off if off > 1.0 else 1.0)
        bias_px[joint, 0] += blame * du
        bias_px[joint, 1] += blame * dv
