"""Which tests a mutant gets, and how a run of them ends."""

from __future__ import annotations

import pytest

from mutants import TESTS_S, chosen, statement_at

SOURCE = """\
LIMIT = 3
VALUES = (
    1,
    2,
)


class Thing:
    size = 4

    def grow(self, by):
        if by > LIMIT and (
            by < 9
        ):
            return max(
                by,
                2,
            )
        return 0
"""


@pytest.mark.parametrize(
    ("line", "first", "last", "inside"),
    [
        (1, 1, 1, False),
        (4, 2, 5, False),
        (9, 9, 9, False),
        (12, 12, 14, True),
        (13, 12, 14, True),
        (17, 15, 18, True),
        (19, 19, 19, True),
    ],
)
def test_statement_at_a_line(line: int, first: int, last: int, inside: bool) -> None:
    span, in_function = statement_at(SOURCE, line)
    assert (span[0], span[-1], in_function) == (first, last, inside)


def test_a_mutant_gets_the_quickest_tests_that_run_its_statement() -> None:
    took_s = {"slow": 2.0, "quick": 0.1, "other": 0.2, "endless": TESTS_S}
    lines = {12: {"slow", "quick", "endless"}, 15: {"quick"}, 19: {"other"}}
    assert chosen(lines, range(12, 15), True, took_s) == ["quick", "slow"]
    assert chosen(lines, range(1, 2), False, took_s) == ["quick", "other", "slow"]
    assert chosen(lines, range(30, 31), True, took_s) == []
