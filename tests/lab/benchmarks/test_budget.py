"""Limits of what programs and verbs cost."""

from __future__ import annotations

import math

from budget import LIMITS, PROGRAMS, costs, table
from e3pose.base.bounded import parse_toml

TABLE = {
    "verb": {"loops": 2.0, "memory_mb": 60},
    "verb demo": {"loops": 5.0, "memory_mb": 60},
    "running edge": {"loops": 1.0},
}


def test_limit_of_a_name_comes_before_that_of_its_kind() -> None:
    measured = {"verb demo": (4.0, 50.0), "verb init": (4.0, 50.0), "verb up": (1.0, 70.0)}
    rows = costs({**measured, "running edge": (0.9, 900.0)}, TABLE)
    assert [row.over() for row in rows] == [False, True, True, False]
    assert rows[-1].limit_mb == math.inf
    assert [line.endswith("OVER") for line in table(rows).splitlines()[1:]] == [
        row.over() for row in rows
    ]


def test_everything_measured_has_a_limit() -> None:
    names = [
        "verb anything",
        *(f"{kind} {name}" for kind in ("import of", "running") for name in PROGRAMS),
    ]
    for row in costs(dict.fromkeys(names, (0.0, 0.0)), parse_toml(LIMITS.read_text(), "limits")):
        assert row.limit_loops < 100 and row.limit_mb < 1000, row.name
