"""Distances from covariances, and dynamics of joints in nine bytes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.cases import each_case
from tests.interpreted import interpreted

from e3pose.model.dynamics import (
    PACKED_SIZE,
    covariance_of,
    find_dynamics,
    packed,
    unpacked,
)
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
    unknown = np.stack([np.eye(3), np.full((3, 3), np.nan)])
    assert np.isnan(expected_distance_m(unknown)).tolist() == [False, True]
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


speeds = st.floats(-30, 30)


@given(
    st.tuples(speeds, speeds, speeds),
    st.floats(2e-4, 5),
    st.floats(2e-4, 5),
    st.floats(-0.98, 0.98),
)
def test_what_is_packed_comes_back(
    velocity: tuple[float, float, float], sigma_m: float, sigma_mps: float, correlation: float
) -> None:
    dynamics = np.array([[*velocity, sigma_m, sigma_mps, correlation], [np.nan] * 6])
    codes = packed(dynamics)
    assert codes.shape == (2, PACKED_SIZE) and codes.dtype == np.uint8
    found = unpacked(codes)
    np.testing.assert_allclose(found[0, :3], velocity, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(found[0, 3:5], [sigma_m, sigma_mps], rtol=0.025)
    np.testing.assert_allclose(found[0, 5], correlation, atol=0.005)
    assert np.isnan(found[1]).all()
    assert np.isnan(unpacked(np.zeros((3, 17, PACKED_SIZE), dtype=np.uint8))).all()  # of no bytes
    assert unpacked(packed(np.zeros((0, 17, 6)))).shape == (0, 17, 6)


def test_the_covariance_is_the_mean_over_the_axes() -> None:
    rng = np.random.default_rng(4)
    root = rng.normal(size=(5, 6, 6))
    covariance = root @ np.swapaxes(root, -1, -2)
    state = rng.normal(size=(5, 6))
    dynamics = np.empty((5, 6))
    for joint in range(5):
        interpreted(find_dynamics)(state[joint], covariance[joint], dynamics[joint])
    np.testing.assert_array_equal(dynamics[:, :3], state[:, 3:])
    found = covariance_of(dynamics)
    for a in range(2):
        for b in range(2):
            block = covariance[:, 3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
            wanted = np.trace(block, axis1=1, axis2=2) / 3
            np.testing.assert_allclose(found[:, a, b], wanted)
    assert (np.linalg.eigvalsh(found) > 0).all()
