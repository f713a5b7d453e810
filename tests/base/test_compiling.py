"""How long compiling still takes."""

from __future__ import annotations

import pytest

from e3pose.base.compiling import left_s, words


@pytest.mark.parametrize(
    ("done", "total", "spent_s", "rest_s"),
    [(0, 100, 0, None), (2, 100, 1, None), (25, 100, 10, 30), (100, 100, 40, 0), (0, 0, 0, None)],
)
def test_rest_is_at_the_pace_so_far(
    done: float, total: float, spent_s: float, rest_s: float | None
) -> None:
    assert left_s(done, total, spent_s) == rest_s


def test_rest_is_told_in_steps_of_five_seconds() -> None:
    assert words(None) == "compiling for this machine, once"
    assert words(41.3) == "compiling: 40 s left"
    assert words(0.2) == "compiling: 5 s left"
