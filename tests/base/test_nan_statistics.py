"""Means and medians of what is known."""

from __future__ import annotations

import numpy as np

from e3pose.base.nan_statistics import mean_of_known, median_of_known

VALUES = np.array([[1.0, np.nan, 5.0, 3.0], [2.0, np.nan, np.nan, np.inf], [np.nan] * 4])


def test_mean_is_that_of_what_is_known() -> None:
    np.testing.assert_array_equal(mean_of_known(VALUES), [3.0, 2.0, np.nan])
    np.testing.assert_array_equal(mean_of_known(VALUES, 2, np.inf), [3.0, np.inf, np.inf])


def test_median_is_the_lower_of_two() -> None:
    np.testing.assert_array_equal(median_of_known(VALUES), [3.0, 2.0, np.nan])
    np.testing.assert_array_equal(median_of_known(VALUES[0, [0, 2, 1]]), 1.0)
    np.testing.assert_array_equal(median_of_known(VALUES, 2, np.inf), [3.0, np.inf, np.inf])
