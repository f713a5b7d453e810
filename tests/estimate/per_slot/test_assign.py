"""The compiled assignment against scipy's."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.estimate.per_slot.assign import assign

ROOM = 9  # rows and columns of the table that the costs are a corner of


def assigned(costs: Floats) -> list[int]:
    """Return the column of each row, -1 for none; what lies outside the costs is poison."""
    num_rows, num_columns = costs.shape
    table = np.full((ROOM, ROOM), np.nan)
    table[:num_rows, :num_columns] = costs
    integers = np.full((5, ROOM), -7, np.int64)
    assign(table, num_rows, num_columns, np.zeros((3, ROOM)), integers, np.ones((2, ROOM), bool))
    return [int(column) for column in integers[0, :num_rows]]


def expected(costs: Floats) -> list[int]:
    columns = [-1] * len(costs)
    for row, column in zip(*linear_sum_assignment(costs), strict=True):
        columns[row] = int(column)
    return columns


sizes = st.integers(1, ROOM)


@settings(max_examples=300)
@given(
    rows=sizes, columns=sizes, seed=st.integers(0, 2**32 - 1), gate=st.sampled_from([0.2, 0.6, 9])
)
def test_assigns_as_scipy_does(rows: int, columns: int, seed: int, gate: float) -> None:
    costs = np.random.default_rng(seed).uniform(size=(rows, columns))
    costs[costs > gate] = 1e3
    assert assigned(costs) == expected(costs)


@settings(max_examples=300)
@given(rows=sizes, columns=sizes, seed=st.integers(0, 2**32 - 1))
def test_equal_costs_still_give_the_least_total(rows: int, columns: int, seed: int) -> None:
    costs = np.random.default_rng(seed).integers(0, 3, (rows, columns)).astype(np.float64)
    found = [(row, column) for row, column in enumerate(assigned(costs)) if column >= 0]
    assert len(found) == len({column for _, column in found}) == min(rows, columns)
    best = costs[linear_sum_assignment(costs)].sum()
    assert sum(costs[pair] for pair in found) == best


@each_case(
    ("costs", "columns"),
    [
        ([[0.5]], [0]),
        ([[1.0, 2.0], [1.0, 9.0]], [1, 0]),  # the first row gives way, though its choice is better
        ([[1.0], [0.0]], [-1, 0]),
        ([[3.0, 0.0, 3.0]], [1]),
    ],
)
def test_named_cases(costs: list[list[float]], columns: list[int]) -> None:
    assert assigned(np.array(costs)) == columns
