"""Where a view is off, it stays so for a while: what that means for the next look."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.estimate.filter.bias import (
    LEARNED_S,
    SHORTEST_S,
    MemoryTerms,
)
from e3pose.estimate.filter.outliers import MEASURED_SIGMAS


def fade(bias_px: Floats, dt: float, terms: MemoryTerms) -> Floats:
    """Return the biases `dt` seconds later."""
    return np.asarray(bias_px * np.exp(-dt / terms.lasting_s))


def learn(
    bias_px: Floats,
    error_px: Floats,
    sigma_px: Floats,
    projected_variance_px2: Floats,
    since_s: Floats,
    terms: MemoryTerms,
) -> Floats:
    """Return the biases of one view after it was seen."""
    off = np.linalg.norm(error_px, axis=-1) / sigma_px
    blame = (
        sigma_px**2
        / (sigma_px**2 + projected_variance_px2)
        / np.maximum(off / MEASURED_SIGMAS, 1.0)
    )
    rate = np.minimum(terms.most, 1 - np.exp(-since_s / LEARNED_S))
    return np.asarray(bias_px + (rate[:, None] * blame)[..., None] * error_px)


def worth_inflation(since_s: Floats, terms: MemoryTerms) -> Floats:
    """Return the factor by which a selector counts it."""
    times = np.maximum(since_s, SHORTEST_S)
    return np.asarray(
        inflation(since_s, terms) + terms.unlearned / np.tanh(times / (2 * terms.lasting_s))
    )


def inflation(since_s: Floats, terms: MemoryTerms) -> Floats:
    """Return the factor on a keypoint's variance, `(*batch)`, so long after the look before."""
    times = np.clip(since_s, SHORTEST_S, terms.lasting_s)
    return np.asarray(terms.fresh + terms.quick / np.tanh(times / (2 * terms.quick_s)))
