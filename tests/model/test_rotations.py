"""Rotations of Rodrigues vectors, against SciPy."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation
from tests.cases import each_case

from e3pose.model.rotations import rotation_of

AXIS = np.array([0.6, -0.48, 0.64])


@each_case("angle", [0.0, 1e-12, 1e-4, 0.7, np.pi - 1e-9, np.pi, 5.0, 100.0])
def test_vector_is_axis_times_angle(angle: float) -> None:
    expected = Rotation.from_rotvec(angle * AXIS).as_matrix()
    np.testing.assert_allclose(rotation_of(angle * AXIS), expected, rtol=0, atol=1e-13)
