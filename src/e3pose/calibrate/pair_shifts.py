"""From the time shifts of pairs of cameras to one offset per camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from e3pose.base.arrays import Floats


def subsample_peak(values: Floats, best: int) -> float:
    """Return where a parabola through the greatest value and its neighbours has its peak.

    Args:
        values: `(num_values,)`, such as correlations by shift.
        best: index of the greatest.

    Returns:
        Steps from `best`, within half a step; 0 at either end.
    """
    if not 0 < best < len(values) - 1:
        return 0.0
    before, middle, after = values[best - 1 : best + 2]
    bend = before - 2 * middle + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0


def spanning_tree_offsets(num_cameras: int, pairs: Sequence[tuple[int, int, float]]) -> Floats:
    """Return each camera's offset against the first, along a maximum spanning tree (Prim).

    Args:
        num_cameras: how many.
        pairs: two cameras, and the second's offset minus the first's; most certain pair first.

    Returns:
        `(num_cameras,)` in the unit of the shifts; NaN where no pair leads to the first camera.
    """
    offsets = np.full(num_cameras, np.nan)
    offsets[0] = 0.0

    def reaches(pair: tuple[int, int, float]) -> bool:
        return bool(np.isnan(offsets[pair[0]]) != np.isnan(offsets[pair[1]]))

    while (pair := next(filter(reaches, pairs), None)) is not None:
        a, b, shift = pair
        if np.isnan(offsets[b]):
            offsets[b] = offsets[a] + shift
        else:
            offsets[a] = offsets[b] - shift
    return offsets


def incidence(num_cameras: int, pairs: Sequence[tuple[int, int, float]]) -> Floats:
    """Return `(num_pairs, num_cameras)`: by which offsets are multiplied to give the shifts."""
    rows = np.zeros((len(pairs), num_cameras))
    for row, (a, b, _) in zip(rows, pairs, strict=True):
        row[a], row[b] = -1.0, 1.0
    return rows


def disagreement(rows: Floats, misses: Floats, weights: Floats) -> Floats:
    """Return `(num_cameras,)` root mean square of what a camera's pairs miss; NaN for one pair.

    Args:
        rows: of `incidence`.
        misses: `(num_pairs,)` the offsets' shift minus the pair's.
        weights: `(num_pairs,)` of the pairs.
    """
    rms = np.full(rows.shape[1], np.nan)
    for camera, column in enumerate(rows.T):
        own = np.flatnonzero(column)
        if len(own) > 1:
            rms[camera] = np.sqrt(np.average(misses[own] ** 2, weights=weights[own]))
    return rms
