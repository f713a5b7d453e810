"""Means and medians of known values."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats


def mean_of_known(values: Floats, least: int = 1, lacking: float = np.nan) -> Floats:
    """Return `(*batch,)` means over the last axis of `(*batch, n)`, NaN and inf left out.

    Args:
        values: `(*batch, n)`.
        least: how many must be known, 1 or more.
        lacking: the mean of fewer.
    """
    known = np.isfinite(values)
    count = known.sum(axis=-1)
    total = np.where(known, values, 0.0).sum(axis=-1)
    return np.where(count >= least, total / np.maximum(count, 1), lacking)


def median_of_known(values: Floats, least: int = 1, lacking: float = np.nan) -> Floats:
    """Return `(*batch,)` medians likewise, of an even number the lower of the two."""
    known = np.isfinite(values)
    count = known.sum(axis=-1)
    ranked = np.sort(np.where(known, values, np.inf), axis=-1)
    middle = np.take_along_axis(ranked, np.maximum(count - 1, 0)[..., None] // 2, axis=-1)
    return np.where(count >= least, middle[..., 0], lacking)
