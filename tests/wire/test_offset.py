"""The clock offset against clocks whose offset, drift and network are known."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.wire.offset import (
    LIKELY_DRIFT_PPM,
    MAX_EXCHANGES,
    Exchange,
    OffsetEstimate,
    take_in,
)

START = 1_700_000_000_000_000_000


def run(
    seconds: int,
    offset_ms: float = 40.0,
    drift_ppm: float = 0.0,
    jitter_ms: float = 0.0,
    one_way_ms: float = 1.0,
    seed: int = 1,
) -> tuple[OffsetEstimate, int]:
    """Exchange once a second; return the estimate and the camera's time at the end."""
    rng = np.random.default_rng(seed)
    estimate = OffsetEstimate()
    camera_ns = START
    for second in range(seconds):
        camera_ns = START + second * 10**9

        def edge(at_ns: float) -> float:
            return at_ns + offset_ms * 1e6 + (at_ns - START) * drift_ppm * 1e-6

        there, back = (one_way_ms * 1e6 + rng.exponential(jitter_ms * 1e6) for _ in range(2))
        asked, received = camera_ns, edge(camera_ns + there)
        answered = camera_ns + there + 50_000 + back
        sent = received + 50_000
        exchange = Exchange.of_stamps(asked, round(received), round(sent), round(answered))
        estimate = take_in(estimate, exchange)
    return estimate, camera_ns


def test_even_network_gives_the_exact_offset() -> None:
    estimate, now = run(5)
    assert estimate.offset.edge_ns(now) - now == pytest.approx(40e6, abs=2000)
    assert estimate.offset.error_ns is not None and estimate.offset.error_ns < 1.3e6


@each_case("seed", range(5))
def test_jitter_of_50_ms_leaves_a_few_milliseconds(seed: int) -> None:
    estimate, now = run(60, jitter_ms=50, seed=seed)
    off = abs(estimate.offset.edge_ns(now) - now - 40e6)
    assert off < 12e6
    assert estimate.offset.error_ns is not None and off < 3 * estimate.offset.error_ns + 1e6


@each_case("drift_ppm", [-80.0, 30.0, 120.0])
def test_drift_is_found_and_followed(drift_ppm: float) -> None:
    estimate, now = run(MAX_EXCHANGES + 5, drift_ppm=drift_ppm, jitter_ms=0.3)
    assert estimate.offset.drift_ppm == pytest.approx(drift_ppm, abs=15)
    assert len(estimate.exchanges) == MAX_EXCHANGES
    later = now + 10 * 10**9
    truth = 40e6 + (later - START) * drift_ppm * 1e-6
    assert estimate.offset.edge_ns(later) - later == pytest.approx(truth, abs=1.5e6)


@each_case("drift_ppm", [0.0, 45.0, -45.0])
def test_error_grows_with_the_age_of_the_exchange_that_is_believed(drift_ppm: float) -> None:
    quick, slow = 2_000_000, 40_000_000  # of delay; the network got busy after the first
    estimate = OffsetEstimate()
    for second in range(16):
        at_ns, delay_ns = START + second * 10**9, quick if second == 0 else slow
        truth_ns = 40_000_000 + round(second * drift_ppm * 1e3)
        estimate = take_in(estimate, Exchange(at_ns, truth_ns, delay_ns))
        error_ns = estimate.offset.error_ns
        assert error_ns is not None
        assert abs(estimate.offset.edge_ns(at_ns) - at_ns - truth_ns) <= error_ns - quick / 2 + 1
    assert error_ns == pytest.approx(quick / 2 + 15 * LIKELY_DRIFT_PPM * 1e3, abs=1)


def test_strange_exchanges_are_believed_after_three() -> None:
    estimate, now = run(30)
    for off_ms, strange in ((15, False), (30, True)):
        exchange = Exchange(now + 10**9, (40 + off_ms) * 10**6, 40_000_000)
        assert take_in(estimate, exchange).outliers == strange
    # Clock that was set is believed after three exchanges.
    far = [Exchange(now + i * 10**9, 5_000_000_000, 2_000_000) for i in range(1, 4)]
    for exchange in far[:2]:
        estimate = take_in(estimate, exchange)
        assert abs(estimate.offset.edge_ns(now) - now - 40e6) < 1e6
    estimate = take_in(estimate, far[2])
    assert estimate.offset.edge_ns(now) - now == pytest.approx(5e9, abs=1e6)
