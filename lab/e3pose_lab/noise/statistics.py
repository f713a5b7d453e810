"""Noise from residuals: sigma by score, gross errors, autocorrelation, bias of views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from e3pose.base.arrays import Floats, Integers
from e3pose.base.errors import InputError
from e3pose.model.noise import LEAST_SCORE, ErrorMemory
from e3pose_lab.noise.residuals import Residuals

EDGES = np.array([LEAST_SCORE, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0 + 1e-9])
LEAST = 400  # keypoints of a bin, whose errors last; bins with fewer are joined
RAYLEIGH = float(np.sqrt(2 * np.log(2)))  # median length of two standard normal coordinates
GROSS_SHARE = 40 / 1032  # of the image, beyond which an error is gross
LAGS_S = (0.04, 0.08, 0.12, 0.2, 0.32, 0.5, 0.8, 1.2, 2.0)
WINSOR = 3.0  # sigmas that one residual may count for in the memory
BIAS_SLOTS = 25  # of one joint in one view, before its mean is called a bias


@dataclass(frozen=True, slots=True, eq=False)
class ViewNoise:
    """Noise of one camera's keypoints.

    Attributes:
        keypoints: how many were compared.
        sigma_px: standard deviation of either coordinate, robust.
        gross_share: share of gross errors.
        bias_px: length of the mean error of a joint, the median over joints and people.
        shift_px: `(2,)` median error of all keypoints, right and down: of the calibration, mostly.
    """

    keypoints: int
    sigma_px: float
    gross_share: float
    bias_px: float
    shift_px: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Statistics:
    """Statistics of a detector, from residuals.

    Attributes:
        scores: `(num_bins,)` mean score, rising.
        counts: `(num_bins,)` keypoints.
        sigma_px: `(num_bins,)` robust, not rising with the score.
        gross_share: `(num_bins,)` share of gross errors.
        autocorrelation: by lag in seconds, of the residuals in units of their sigma.
        views: by camera index.
    """

    scores: Floats
    counts: Integers
    sigma_px: Floats
    gross_share: Floats
    autocorrelation: dict[float, float]
    views: dict[int, ViewNoise]


def describe(residuals: Residuals, interval_s: float, image_px: float) -> Statistics:
    """Return the statistics of residuals.

    Raises:
        InputError: when there are too few of them.
    """
    if len(residuals) < LEAST:
        raise InputError(
            f"noise: found {len(residuals)} keypoints that two other views confirm, "
            f"expected at least {LEAST}: a longer recording, or more cameras"
        )
    length = np.linalg.norm(residuals.errors_px, axis=-1)
    bins = _bins(residuals.scores)
    counts = np.bincount(bins)
    scores = np.bincount(bins, weights=residuals.scores) / counts
    gross = length > GROSS_SHARE * image_px
    median = np.array([np.median(length[bins == index]) for index in range(len(counts))])
    sigma = falling(median / RAYLEIGH, counts)
    expected = np.interp(residuals.scores, scores, sigma)
    return Statistics(
        scores,
        counts,
        sigma,
        np.bincount(bins, weights=gross) / counts,
        autocorrelation(residuals, expected, interval_s),
        {
            camera: _view(residuals, residuals.cameras == camera, length, gross)
            for camera in np.unique(residuals.cameras).tolist()
        },
    )


def falling(values: Floats, weights: NDArray[np.generic]) -> Floats:
    """Return the nearest sequence that never rises: pool adjacent violators, weighted means."""
    pools: list[tuple[float, float, int]] = []  # mean, weight, length
    for value, weight in zip(values.tolist(), np.asarray(weights, dtype=float), strict=True):
        pools.append((value, float(weight), 1))
        while len(pools) > 1 and pools[-1][0] > pools[-2][0]:
            (b, wb, nb), (a, wa, na) = pools.pop(), pools.pop()
            pools.append(((a * wa + b * wb) / (wa + wb), wa + wb, na + nb))
    return np.concatenate([np.full(n, mean) for mean, _, n in pools])


def autocorrelation(
    residuals: Residuals, sigma_px: Floats, interval_s: float
) -> dict[float, float]:
    """Return the correlation of residuals of one joint in one view with later ones, by lag."""
    z = residuals.errors_px / sigma_px[:, None]
    z = z * np.minimum(1, WINSOR / np.maximum(np.linalg.norm(z, axis=-1), 1e-9))[:, None]
    order = np.lexsort((residuals.slots, residuals.series))
    z = z[order]
    # Series lie so far apart on one time axis that no lag reaches from one to the next.
    apart = int(residuals.slots.max()) + 2 * round(max(LAGS_S) / interval_s) + 2
    times = residuals.series[order] * apart + residuals.slots[order]
    lasts = int(np.ptp(residuals.slots))  # few pairs have a longer lag than half of it
    found = {}
    for lag_s in LAGS_S:
        lag = round(lag_s / interval_s)
        if lag == 0 or lag > lasts / 2 or abs(lag * interval_s - lag_s) > 0.5 * lag_s:
            continue
        later = np.searchsorted(times, times + lag)
        hit = later < len(times)
        hit[hit] &= times[later[hit]] == times[hit] + lag
        if hit.sum() < LEAST:
            continue
        first, second = z[hit], z[later[hit]]
        scale = np.sqrt((first**2).sum() * (second**2).sum())
        found[lag * interval_s] = float((first * second).sum() / scale)
    return found


def fit_memory(correlations: Mapping[float, float]) -> ErrorMemory:
    """Return the memory that fits correlations by lag in seconds best, by least squares.

    The correlation times are those of the default: few recordings are long enough to tell them.
    """
    memory = ErrorMemory()
    if not correlations:
        return replace(memory, lasting_share=0.0, quick_share=0.0)
    lags = np.array([0.0, *correlations])
    target = np.array([1.0, *correlations.values()])
    times_s = (memory.quick_s, memory.lasting_s)
    columns = [(lags == 0).astype(float), *(np.exp(-lags / lasts_s) for lasts_s in times_s)]
    shares = nnls(np.stack(columns, axis=1), target)[0]
    _, quick, lasting = (shares / shares.sum()).tolist()
    return replace(memory, lasting_share=lasting, quick_share=quick)


def _bins(scores: Floats) -> Integers:
    """Return the bin of each score; bins that hold too little are joined to their neighbours."""
    index = np.clip(np.digitize(scores, EDGES) - 1, 0, len(EDGES) - 2)
    counts = np.bincount(index, minlength=len(EDGES) - 1)
    joined, current, held = np.zeros(len(counts), dtype=np.int64), 0, 0
    for bin_index, count in enumerate(counts.tolist()):
        if held >= LEAST and counts[bin_index:].sum() >= LEAST:
            current, held = current + 1, 0
        joined[bin_index] = current
        held += count
    return joined[index]


def _view(
    residuals: Residuals, mine: NDArray[np.bool_], length: Floats, gross: NDArray[np.bool_]
) -> ViewNoise:
    errors, series = residuals.errors_px[mine], residuals.series[mine]
    _, place, counts = np.unique(series, return_inverse=True, return_counts=True)
    capped = np.where(gross[mine, None], np.nan, errors)  # one wild moment is no bias
    means = [
        np.nanmean(capped[place == index], axis=0)
        for index in np.flatnonzero(counts >= BIAS_SLOTS)
        if np.isfinite(capped[place == index]).any()
    ]
    return ViewNoise(
        int(mine.sum()),
        float(np.median(length[mine]) / RAYLEIGH),
        float(gross[mine].mean()),
        float(np.median(np.linalg.norm(means, axis=-1))) if means else float("nan"),
        np.median(errors, axis=0),
    )
