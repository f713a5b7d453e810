"""Distances from covariances, against formulas and against many draws."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.model.uncertainty import TAILS, distance_within_m, expected_distance_m


@each_case(
    ("axes", "mean", "within"),
    [
        # Mean of a chi variable of 1, 2 and 3 degrees of freedom; 90 % quantile of the root of
        # that many times an F variable with 4 in the denominator, over the root of pi / 2.
        ((1.0, 0.0, 0.0), 0.797885, 2.131847 / 1.253314),
        ((1.0, 1.0, 0.0), 1.253314, 2.940937 / 1.253314),
        ((1.0, 1.0, 1.0), 1.595769, 3.545784 / 1.253314),
    ],
)
def test_equal_axes_are_exact(axes: tuple[float, ...], mean: float, within: float) -> None:
    covariance = 0.02**2 * np.diag(axes)
    assert expected_distance_m(covariance) == pytest.approx(0.02 * mean, rel=1e-5)
    assert distance_within_m(covariance, 0.9) == pytest.approx(0.02 * within, rel=1e-5)


def test_unequal_turned_axes_agree_with_draws_within_three_percent() -> None:
    rng = np.random.default_rng(0)
    tails = np.sqrt(TAILS / rng.chisquare(TAILS, size=200_000))
    for _ in range(10):
        root = rng.normal(size=(3, 3)) * [1.0, 0.5, 0.2]
        covariance = root @ root.T
        distances = np.linalg.norm(rng.normal(size=(200_000, 3)) @ root.T, axis=1)
        assert expected_distance_m(covariance) == pytest.approx(distances.mean(), rel=0.03)
        within = float(distance_within_m(covariance, 0.9))
        of_errors = distances * tails
        of_errors *= distances.mean() / of_errors.mean()
        assert (of_errors < within).mean() == pytest.approx(0.9, abs=0.01)


def test_unknown_stays_unknown() -> None:
    covariance = np.stack([np.eye(3), np.full((3, 3), np.nan)])
    assert np.isnan(expected_distance_m(covariance)).tolist() == [False, True]
