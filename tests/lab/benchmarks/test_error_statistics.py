"""Statistics of errors find what was put into the keypoints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from detector_errors import Keypoints, by_direction, capped, remembered, shared, table

INTERVAL_S = 0.04


def keypoints(errors: NDArray[np.float64], sector: NDArray[np.int64] | None = None) -> Keypoints:
    """Errors `(num_series, num_slots, 2)` in centimetres, each series of one joint in one view."""
    number, slots = errors.shape[:2]
    flat = errors.reshape(-1, 2)
    series = np.repeat(np.arange(number), slots)
    ones = np.ones(len(flat))
    return Keypoints(
        flat, flat, ones, 0 * series, 0 * series, series, np.tile(np.arange(slots), number),
        0 * series if sector is None else sector, 0 * ones, 0 * ones, ones < 0, ones > 0, ones > 0,
        ones, ones, ones,
    )  # fmt: skip


def test_errors_that_last_correlate_and_new_ones_do_not() -> None:
    rng = np.random.default_rng(0)
    lasting, new = rng.normal(size=(400, 1, 2)), rng.normal(size=(400, 200, 2))
    for share in (0.0, 0.5, 1.0):
        errors = np.sqrt(share) * lasting + np.sqrt(1 - share) * new
        found = remembered(keypoints(errors), INTERVAL_S)
        assert found == pytest.approx([share] * 4, abs=0.05)


def test_a_lag_never_reaches_from_one_series_to_another() -> None:
    errors = np.repeat(np.random.default_rng(1).normal(size=(1, 60, 2)), 50, axis=0)
    assert np.isnan(remembered(keypoints(errors), INTERVAL_S)[3])  # 5 s of 2.4 s


def test_errors_that_views_share_are_told_from_their_own() -> None:
    rng = np.random.default_rng(3)
    common, own = rng.normal(size=(1, 5000, 2)), rng.normal(size=(3, 5000, 2))
    rows = keypoints(np.sqrt(0.4) * common + np.sqrt(0.6) * own)
    rows = replace(rows, camera=rows.series, series=17 * rows.series)  # one person in three views
    assert shared(rows) == pytest.approx(0.4, abs=0.03)
    assert shared(replace(rows, error_cm=own.reshape(-1, 2))) == pytest.approx(0.0, abs=0.03)


def test_one_wild_error_counts_for_no_more_than_the_cap() -> None:
    assert capped(np.array([[300.0, 400.0], [3.0, 4.0]])) == pytest.approx(
        np.array([[9.0, 12.0], [3.0, 4.0]])
    )


def test_bias_by_direction_is_found() -> None:
    rng = np.random.default_rng(2)
    sector = np.tile(np.arange(8), 1000)
    bias = 3.0 * np.stack([np.cos(sector), np.sin(sector)], axis=-1)
    errors = (bias + rng.normal(size=bias.shape)).reshape(1, -1, 2)
    assert by_direction(keypoints(errors, sector)) == pytest.approx(3.0, abs=0.1)
    assert by_direction(keypoints(errors - bias[None], sector)) < 0.15


def test_table_has_a_row_per_statistic_and_leaves_unknown_ones_open() -> None:
    lines = list(table({"a": {"x": 1.234, "y": 12.34}, "b": {"x": float("nan"), "y": 0.0}}))
    assert lines[0] == "| | a | b |"
    assert lines[2:] == ["| x | 1.23 |  |", "| y | 12.3 | 0.00 |"]
