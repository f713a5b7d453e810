"""Errors that last longer than usual, by the biases that are learned."""

from __future__ import annotations

import numpy as np
import pytest

from e3pose.estimate.filter.lasting import MEMORY_S, MOST, SPAN, USUAL, Lasting


def after(share: float, seconds: float = 30.0) -> Lasting:
    found = Lasting()
    for _ in range(round(seconds / 0.1)):
        found = found.after(share, 0.1)
    return found


def test_biases_count_as_far_as_they_are_larger_than_usual() -> None:
    assert after(USUAL / 2).excess == 0.0
    assert after(USUAL + SPAN / 2).excess == pytest.approx(0.5, abs=0.01)
    assert after(9.0).excess == MOST
    assert 0 < after(USUAL + SPAN, 0.35).excess < after(USUAL + SPAN).excess


def test_slots_without_people_and_after_a_pause_say_nothing() -> None:
    begun = after(USUAL + SPAN)
    assert begun.after(np.nan, 0.1).excess == pytest.approx(begun.excess)
    assert begun.after(0.0, MEMORY_S).excess == begun.excess
    assert Lasting().after(9.0, np.nan).excess == pytest.approx(0.0)
