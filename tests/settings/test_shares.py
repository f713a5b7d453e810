"""Shares of the slots: what budgets come to, and which do not pay for the cameras."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.settings.loop import LoopSettings
from e3pose.settings.parts import row_of, shares

Budget = float | tuple[float, ...]


@each_case(
    ("budget", "count"), [(0.6, 3), ((1.0, 0.7, 0.5, 0.4, 0.4), 3), (1.0, 5), ((0.2,) * 5, 1)]
)
def test_budget_that_pays_is_what_every_camera_has(budget: Budget, count: float) -> None:
    settings = LoopSettings(budget=budget, num_selected=count)
    found = shares(settings, row_of(settings), 5)
    np.testing.assert_array_equal(found, np.broadcast_to(budget, 5))


@each_case(
    ("budget", "count", "said"),
    [
        (0.59, 3, "budget: found 0.59, expected at least 0.6 for 3 of 5 cameras per slot"),
        ((0.8, 0.8, 0.5, 0.4, 0.4), 3, "found 2.9 cameras per slot in all, expected at least 3"),
        ((0.8,) * 4, 3, "found 4 shares, expected 5"),
    ],
)
def test_budget_that_does_not_pay_is_said(budget: Budget, count: float, said: str) -> None:
    settings = LoopSettings(budget=budget, num_selected=count)
    with pytest.raises(InputError) as error:
        shares(settings, row_of(settings), 5)
    assert said in str(error.value)
