"""Housekeeping: what it calls a problem of a camera."""

from __future__ import annotations

from tests.cases import each_case

from e3pose.edge.housekeeping import lasting_problem


@each_case(
    ("why", "was", "lasts"),
    [
        ("asleep for 3 s", "", ""),
        ("connecting", "", ""),  # woke while its edge was started again
        ("connecting", "never connected", "never connected"),
        ("not connected", "", "not connected"),
        ("overslept by 5 s", "", "overslept by 5 s"),
        ("", "not connected", ""),
    ],
)
def test_who_sleeps_or_connects_is_neither_lost_nor_back(why: str, was: str, lasts: str) -> None:
    assert lasting_problem(why, was) == lasts
