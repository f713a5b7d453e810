"""The aim that makes what is stated meet a target."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from e3pose.model.uncertainty import expected_distance_m
from e3pose.select.stated_error import CORRECTION, MEMORY_S, MOST, StatedError, stated_error_m

TARGET_M = 0.04
SLOT_S = 0.1
FULL = 1 - 1e-9


def spheres(sigma_m: float, people: int = 2) -> NDArray[np.float64]:
    return np.broadcast_to(np.eye(3) * sigma_m**2, (people, 17, 3, 3))


def error_m(sigma_m: float) -> float:
    return float(expected_distance_m(spheres(sigma_m)[0, 0]))


def after(stated: StatedError, sigma_m: float, seconds: float) -> StatedError:
    for _ in range(round(seconds / SLOT_S)):
        stated = stated.after(stated_error_m(spheres(sigma_m)), SLOT_S)
    return stated


def test_the_mean_is_the_plain_one_at_first_and_forgets_with_its_memory() -> None:
    stated = after(after(StatedError(), 0.02, SLOT_S), 0.01, SLOT_S)
    middle_m = (error_m(0.02) + error_m(0.01)) / 2
    assert stated.mean_m == pytest.approx(middle_m, rel=0.01)
    stated = after(StatedError(error_m(0.02), FULL), 0.01, MEMORY_S)
    expected_m = error_m(0.01) + (error_m(0.02) - error_m(0.01)) / np.e
    assert stated.mean_m == pytest.approx(expected_m, rel=1e-6)


def test_the_memory_fills_while_errors_are_stated() -> None:
    assert StatedError().filled == 0.0
    stated = after(StatedError(), 0.02, MEMORY_S)
    assert stated.filled == pytest.approx(1 - 1 / np.e)


def test_nobody_and_unknown_joints_change_nothing() -> None:
    stated = after(StatedError(), 0.03, 1.0)
    assert stated.after(stated_error_m(spheres(0.02, 0)), SLOT_S) == stated
    assert stated.after(stated_error_m(np.full((1, 17, 3, 3), np.nan)), SLOT_S) == stated
    some = spheres(0.02).copy()
    some[:, 5:] = np.nan
    assert stated.after(stated_error_m(some), SLOT_S).mean_m == pytest.approx(
        stated.after(stated_error_m(spheres(0.02)), SLOT_S).mean_m, rel=1e-12
    )


def test_the_aim_is_the_target_where_that_is_what_is_stated_or_nothing_is() -> None:
    assert StatedError(TARGET_M, FULL).aim_m(TARGET_M) == pytest.approx(TARGET_M)
    assert StatedError().aim_m(TARGET_M) == TARGET_M


def test_the_aim_goes_the_other_way_within_bounds() -> None:
    low, high = (StatedError(times * TARGET_M, FULL).aim_m(TARGET_M) for times in (0.9, 1.1))
    assert low > TARGET_M > high
    assert StatedError(1e-6, FULL).aim_m(TARGET_M) == MOST * TARGET_M
    assert StatedError(10.0, FULL).aim_m(TARGET_M) == TARGET_M / MOST


def test_the_certainty_that_the_warm_up_leaves_is_hardly_made_up_for() -> None:
    """Half a second after all cameras looked, errors are far below any target."""
    stated = after(StatedError(), 0.25 * TARGET_M, 0.5)
    assert stated.mean_m < TARGET_M / 2
    assert stated.aim_m(TARGET_M) < 1.4 * TARGET_M
    assert StatedError(stated.mean_m, FULL).aim_m(TARGET_M) == MOST * TARGET_M


@pytest.mark.parametrize("stated_over_expected", [0.9, 1.1])
def test_a_sixth_of_what_is_missed_is_left(stated_over_expected: float) -> None:
    stated_m = TARGET_M
    for _ in range(1000):
        aim_m = StatedError(stated_m, FULL).aim_m(TARGET_M)
        stated_m += 0.02 * (stated_over_expected * aim_m - stated_m)
    left = stated_over_expected ** (1 / (1 + CORRECTION))
    assert stated_m == pytest.approx(left * TARGET_M, rel=1e-3)
