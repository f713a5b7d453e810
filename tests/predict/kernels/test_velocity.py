"""Newest places and constant velocity: the compiled form against plain numpy."""

from __future__ import annotations

import numpy as np
from tests.cases import each_case
from tests.reference import velocity as plain

from e3pose.predict.velocities import ConstantVelocity, newest_known


@each_case("num_slots", [1, 2, 5])
@each_case("seed", range(4))
def test_what_is_predicted_is_that_of_numpy(num_slots: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    history = rng.normal(size=(num_slots, 4, 6, 3))
    history[rng.random(history.shape[:3]) < 0.4] = np.nan
    history[:, 1] = np.nan
    for found, expected in zip(newest_known(history), plain.newest_known(history), strict=True):
        np.testing.assert_array_equal(found, expected)
    found = ConstantVelocity().predict(history, 0.04, 3).joints_m
    np.testing.assert_allclose(found, plain.constant_velocity(history, 3), atol=1e-12)
