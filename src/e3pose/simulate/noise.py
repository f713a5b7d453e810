"""Autocorrelated keypoint noise with a sigma by score.

This is the noise `simulated`. It resembles OpenPose's on the Shelf recording: its figures are the
residuals by score, the share of gross errors, and how residuals of one view, person and joint
resemble those of the frames before (`model.noise.ErrorMemory`), to a smoother over all views. That
smoother follows the view it is compared with, so that between scores of .55 and .8 the residuals
are a quarter to a third less than OpenPose's noise, which is measured by leaving one view out.
"""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats

# Share of the variance, seconds: a detector that has taken a chair for a leg keeps doing so.
GROSS_MEMORY = ((1.0, 2.5),)
SCORES = np.array([0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.95])
MEDIAN_PX = np.array([16.6, 14.9, 14.0, 11.1, 9.6, 7.6, 5.5, 3.7, 2.7])
GROSS_SHARE = np.array([0.19, 0.17, 0.13, 0.065, 0.032, 0.027, 0.013, 0.009, 0.004])
GROSS_PX = 40.0  # what counts as gross
GROSS_SIGMA_PX = 40.0  # spread of the component that makes gross errors
# Shelf shows people at 240 to 430 pixels a metre without any dependence of the residual on size;
# outside that band the noise is taken to grow and shrink with the person.
SHELF_PX_PER_M = (240.0, 430.0)
LEAST_SCALE = 0.2


def correlated(
    rng: np.random.Generator,
    shape: tuple[int, ...],
    interval_s: float,
    parts: tuple[tuple[float, float], ...],
) -> Floats:
    """Return standard normal noise `shape`, correlated along its first axis, which is time.

    Args:
        rng: source of randomness.
        shape: `(num_slots, *batch)`.
        interval_s: between slots.
        parts: share of the variance and correlation time in seconds of each, as in
            `ErrorMemory.parts`.
    """
    total: Floats = np.zeros(shape)
    for share, memory_s in parts:
        part = rng.standard_normal(shape)
        if memory_s > 0:
            keep = float(np.exp(-interval_s / memory_s))
            part[1:] *= np.sqrt(1 - keep * keep)
            for slot in range(1, shape[0]):
                part[slot] += keep * part[slot - 1]
        part *= np.sqrt(share)
        total += part
    return total


def normal_cdf(x: Floats) -> Floats:
    """Return the standard normal distribution function, to 1e-7.

    Abramowitz and Stegun, Handbook of Mathematical Functions, 26.2.17.
    """
    t = 1 / (1 + 0.2316419 * np.abs(x))
    series = 1.781477937 + t * (-1.821255978 + t * 1.330274429)
    series = t * (0.319381530 + t * (-0.356563782 + t * series))
    upper = np.exp(-0.5 * x * x) / np.sqrt(2 * np.pi) * series
    return np.asarray(np.where(x > 0, 1 - upper, upper))


def residuals(direction: Floats, gross: Floats, scores: Floats, px_per_m: Floats) -> Floats:
    """Return keypoint errors `(*batch, 2)` in pixels with the medians and tails of their scores.

    Args:
        direction: `(*batch, 2)` standard normal.
        gross: `(*batch)` uniform in [0, 1]; low values make gross errors.
        scores: `(*batch)` in [0, 1].
        px_per_m: `(*batch)` apparent size of the person.
    """
    # Both components are 2D normal, so their lengths are Rayleigh distributed; the narrow one is
    # what remains of the median when the wide one has explained the gross errors.
    share = GROSS_SHARE / np.exp(-0.5 * (GROSS_PX / GROSS_SIGMA_PX) ** 2)
    wide_below = 1 - np.exp(-0.5 * (MEDIAN_PX / GROSS_SIGMA_PX) ** 2)
    narrow_below = (0.5 - share * wide_below) / (1 - share)
    sigma = MEDIAN_PX / np.sqrt(-2 * np.log(1 - narrow_below))
    is_gross = gross < np.interp(scores, SCORES, share)
    spread = np.where(is_gross, GROSS_SIGMA_PX, np.interp(scores, SCORES, sigma))
    return direction * (spread * size_scale(px_per_m))[..., None]


def size_scale(px_per_m: Floats) -> Floats:
    """Return the factor on Shelf's residuals for people who appear at so many pixels a metre."""
    low, high = SHELF_PX_PER_M
    scale = np.where(px_per_m < low, px_per_m / low, np.maximum(px_per_m / high, 1.0))
    return np.asarray(np.maximum(scale, LEAST_SCALE))
