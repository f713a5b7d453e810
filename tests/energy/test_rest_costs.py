"""What sleeping cameras draw, falling asleep and waking included."""

from __future__ import annotations

import numpy as np

from e3pose.energy.modes import Rest
from e3pose.energy.rest_costs import rest_costs

COSTS = rest_costs([12.0, 12.0], [6.0, 6.0], [Rest("suspended", 0.5, 0.4, 1.0, 0.2), None])


def test_a_camera_without_a_rest_stays_awake() -> None:
    assert COSTS.rests.tolist() == [True, False]
    assert COSTS.drawn_w(np.zeros(2, bool), np.ones(2, bool)).tolist() == [0.5, 6.0]


def test_alarms_go_off_two_deviations_early() -> None:
    np.testing.assert_allclose(COSTS.alarm_s, [1.4, 0.0])
    np.testing.assert_allclose(COSTS.lost_s, [1.8, 0.0])


def test_a_short_rest_saves_nothing_and_a_long_one_nearly_all() -> None:
    for rest_s in (0.9, 1.8):
        np.testing.assert_allclose(COSTS.resting_w(np.full(2, rest_s))[0], 6.0)
    np.testing.assert_allclose(COSTS.resting_w(np.full(2, 18.0))[0], 0.1 * 6 + 0.9 * 0.5)


def test_falling_asleep_and_waking_are_not_deep() -> None:
    asleep = np.zeros((100, 2), dtype=bool)
    asleep[10:50, 0] = True
    deep = COSTS.deep(asleep, 0.1)
    assert np.flatnonzero(deep[:, 0]).tolist() == list(range(14, 36))
    asleep[40:45, 0] = False  # the second rest is too short to be one
    deep = COSTS.deep(asleep, 0.1)
    assert np.flatnonzero(deep[:, 0]).tolist() == list(range(14, 26))


def test_a_rest_that_the_end_cuts_off_has_no_waking_in_it() -> None:
    asleep = np.zeros((30, 2), dtype=bool)
    asleep[10:, 0] = True
    assert np.flatnonzero(COSTS.deep(asleep, 0.1)[:, 0]).tolist() == list(range(14, 30))
