"""Error radius from the covariance of a position."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats

# Degrees of freedom of the t-distribution of errors over the distance expected of them; it holds
# their quantiles from 50 to 99 % (`lab/experiments/2026-11-22-inflation-by-person.md`).
TAILS = 4.0


def expected_distance_m(covariance_m2: Floats) -> Floats:
    """Return the mean distance of a normally distributed position from its mean.

    Args:
        covariance_m2: `(*batch, 3, 3)`; NaN where unknown.

    Returns:
        `(*batch)` metres, NaN where unknown. The squared distance is taken as a chi-square scaled
        to its mean and variance (Satterthwaite): exact for one, two or three equal axes.
    """
    total = np.trace(covariance_m2, axis1=-2, axis2=-1)
    squared = (covariance_m2 * np.swapaxes(covariance_m2, -1, -2)).sum(axis=(-1, -2))
    return mean_distance(total, total**2 / squared)


def axis_sigma_m(covariance_m2: Floats) -> Floats:
    """Return the standard deviation along an axis, `(*batch)` metres: of the mean of the three."""
    return np.asarray(np.sqrt(np.maximum(np.trace(covariance_m2, axis1=-2, axis2=-1) / 3, 0.0)))


def distance_within_m(covariance_m2: Floats, share: float) -> Floats:
    """Return the distance `(*batch)` that holds `share` of the positions, in metres.

    Covariances are right on average, but one is too large and another too small, so that errors
    have the tails of a t-distribution. This one has the mean of `expected_distance_m`; 0.9 is the
    band that reports show.
    """
    from scipy.special import fdtri, poch

    total = np.trace(covariance_m2, axis1=-2, axis2=-1)
    squared = (covariance_m2 * np.swapaxes(covariance_m2, -1, -2)).sum(axis=(-1, -2))
    degrees = total**2 / squared
    # The mean of the root of an inverse chi-square variable: that of a t-distribution's scale.
    mean = np.sqrt(TAILS / 2) / poch(TAILS / 2 - 0.5, 0.5)
    return np.asarray(np.sqrt(total * fdtri(degrees, TAILS, share)) / mean)


def mean_distance(total: Floats, degrees: Floats) -> Floats:
    """Return the mean of a distance `(*batch)` whose square has a scaled chi-square distribution.

    Args:
        total: `(*batch)` mean of the square, square metres.
        degrees: `(*batch)` degrees of freedom.
    """
    from scipy.special import poch  # takes longer to import than all else here

    return np.asarray(np.sqrt(2 * total / degrees) * poch(degrees / 2, 0.5))
