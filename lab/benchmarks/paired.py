"""Paired comparisons: the same recordings under two policies, with confidence intervals. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

Floats = NDArray[np.float64]

LEVEL = 0.95
RESAMPLES = 2000


@dataclass(frozen=True, slots=True)
class Interval:
    """An estimate with its 95 % confidence interval."""

    mean: float
    low: float
    high: float


def mean_interval(values: Floats) -> Interval:
    """Return the mean of independent values with Student's interval; no width for one value.

    Args:
        values: `(num_pairs,)`.
    """
    mean = float(np.mean(values))
    if len(values) < 2:
        return Interval(mean, mean, mean)
    half = float(stdtrit(len(values) - 1, (1 + LEVEL) / 2))
    half *= float(np.std(values, ddof=1)) / len(values) ** 0.5
    return Interval(mean, mean - half, mean + half)


def gain_percent(reference: Floats, other: Floats) -> Interval:
    """Return by how many percent `other` is lower than `reference`, over pairs.

    Args:
        reference: `(num_pairs,)` errors, above 0.
        other: `(num_pairs,)` errors on the same recordings.
    """
    return mean_interval(100 * (1 - other / reference))


def saving_percent(
    reference_counts: Floats, reference: Floats, count: Floats, error: Floats, seed: int = 0
) -> Interval | None:
    """Return how much less energy a policy takes than the reference does for the same error.

    The reference's mean error as a function of its mean energy is interpolated, both logarithmic,
    and read where it equals the other's mean error; the interval is a bootstrap over recordings.

    Args:
        reference_counts: `(num_counts, num_pairs)` energy of the reference, rising, such as cameras
            on.
        reference: `(num_counts, num_pairs)` its errors.
        count: `(num_pairs,)` energy of the other policy.
        error: `(num_pairs,)` its errors.
        seed: of the bootstrap.

    Returns:
        Percent; None where the other's error lies outside what the reference was measured to make.
    """

    def saving(pairs: NDArray[np.int64]) -> float:
        energies = np.log(reference_counts[:, pairs].mean(axis=1))
        # More cameras never hurt but for noise; interpolation needs errors that fall.
        errors = np.log(np.minimum.accumulate(reference[:, pairs].mean(axis=1)))
        wanted = float(np.log(error[pairs].mean()))
        if not errors[-1] <= wanted <= errors[0]:
            return np.nan
        needed = np.exp(np.interp(wanted, errors[::-1], energies[::-1]))
        return float(100 * (1 - count[pairs].mean() / needed))

    number = error.shape[-1]
    mean = saving(np.arange(number))
    if np.isnan(mean):
        return None
    rng = np.random.default_rng(seed)
    drawn = np.array([saving(pairs) for pairs in rng.integers(number, size=(RESAMPLES, number))])
    low, high = np.nanpercentile(drawn, [50 * (1 - LEVEL), 50 * (1 + LEVEL)])
    return Interval(mean, float(low), float(high))


def errors_with_misses(
    mpjpe_mm: Sequence[float | None], recall: Sequence[float | None], miss_mm: float = 500.0
) -> Floats:
    """Return mean errors in mm in which everybody who was not found counts as `miss_mm` off.

    A policy cannot gain by losing the people who are hard to see.
    """
    found = np.array([0.0 if share is None else share for share in recall])
    errors = np.array([miss_mm if error is None else error for error in mpjpe_mm])
    return np.asarray(found * errors + (1 - found) * miss_mm)
