"""Slots per second are those of a machine that runs."""

from __future__ import annotations

import pytest
from tests.cases import each_case

from e3pose.edge.counters import SUSPENDED_S, Counts

INTERVAL_S = 0.04


@each_case(("away_s", "fps"), [(SUSPENDED_S, 25.0), (600.0, 25.0), (10.0, 20.0)])
def test_suspended_machine_is_not_slow(away_s: float, fps: float) -> None:
    counts = Counts(4, INTERVAL_S, slots=1000, first_ns=5)
    counts.skip(round(away_s / INTERVAL_S))
    now_ns = 5 + round((1000 * INTERVAL_S + away_s) * 1e9)
    assert counts.fps(now_ns) == pytest.approx(fps)
    assert counts.lost == round(away_s / INTERVAL_S)
