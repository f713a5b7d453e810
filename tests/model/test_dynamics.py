"""Dynamics of joints, packed into nine bytes and back."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from e3pose.model.dynamics import (
    PACKED_SIZE,
    covariance_of,
    find_dynamics,
    packed,
    unpacked,
)

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


def test_nothing_is_known_of_empty_bytes() -> None:
    assert np.isnan(unpacked(np.zeros((3, 17, PACKED_SIZE), dtype=np.uint8))).all()
    assert unpacked(packed(np.zeros((0, 17, 6)))).shape == (0, 17, 6)


def test_the_covariance_is_the_mean_over_the_axes() -> None:
    rng = np.random.default_rng(4)
    root = rng.normal(size=(5, 6, 6))
    covariance = root @ np.swapaxes(root, -1, -2)
    state = rng.normal(size=(5, 6))
    dynamics = np.empty((5, 6))
    for joint in range(5):
        find_dynamics(state[joint], covariance[joint], dynamics[joint])
    np.testing.assert_array_equal(dynamics[:, :3], state[:, 3:])
    found = covariance_of(dynamics)
    for a in range(2):
        for b in range(2):
            block = covariance[:, 3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
            wanted = np.trace(block, axis1=1, axis2=2) / 3
            np.testing.assert_allclose(found[:, a, b], wanted)
    assert (np.linalg.eigvalsh(found) > 0).all()
