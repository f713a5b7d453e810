"""The aim that makes what is stated meet a target."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from e3pose.model.uncertainty import expected_distance_m
from e3pose.select.stated_error import CORRECTION, MEMORY_S, MOST, aim_m, recent_error_m

TARGET_M = 0.04


def spheres(sigma_m: float, people: int = 2) -> NDArray[np.float64]:
    return np.broadcast_to(np.eye(3) * sigma_m**2, (people, 17, 3, 3))


def test_the_mean_forgets_with_its_memory() -> None:
    before_m = float(expected_distance_m(spheres(0.02)[0, 0]))
    after_m = float(expected_distance_m(spheres(0.01)[0, 0]))
    stated_m = recent_error_m(math.nan, spheres(0.02), 0.1)
    assert stated_m == pytest.approx(before_m)
    for _ in range(round(MEMORY_S / 0.1)):
        stated_m = recent_error_m(stated_m, spheres(0.01), 0.1)
    assert stated_m == pytest.approx(after_m + (before_m - after_m) / math.e, rel=1e-6)


def test_nobody_and_unknown_joints_change_nothing() -> None:
    assert math.isnan(recent_error_m(math.nan, spheres(0.02, 0), 0.1))
    assert recent_error_m(0.03, np.full((1, 17, 3, 3), np.nan), 0.1) == 0.03
    some = spheres(0.02).copy()
    some[:, 5:] = np.nan
    all_m = recent_error_m(math.nan, spheres(0.02), 0.1)
    assert recent_error_m(math.nan, some, 0.1) == pytest.approx(all_m, rel=1e-12)


def test_the_aim_is_the_target_where_that_is_what_is_stated_or_nothing_is() -> None:
    assert aim_m(TARGET_M, TARGET_M) == pytest.approx(TARGET_M)
    assert aim_m(TARGET_M, math.nan) == TARGET_M


def test_the_aim_goes_the_other_way_within_bounds() -> None:
    assert aim_m(TARGET_M, 0.9 * TARGET_M) > TARGET_M > aim_m(TARGET_M, 1.1 * TARGET_M)
    assert aim_m(TARGET_M, 1e-6) == MOST * TARGET_M
    assert aim_m(TARGET_M, 10.0) == TARGET_M / MOST


@pytest.mark.parametrize("stated_over_expected", [0.8, 0.9, 1.2])
def test_a_third_of_what_is_missed_is_left(stated_over_expected: float) -> None:
    stated_m = TARGET_M
    for _ in range(200):
        stated_m += 0.1 * (stated_over_expected * aim_m(TARGET_M, stated_m) - stated_m)
    left = stated_over_expected ** (1 / (1 + CORRECTION))
    assert stated_m == pytest.approx(left * TARGET_M, rel=1e-3)
