"""The lead over delays of minutes: back to the need in 20 s, few late orders, no oscillation."""

from __future__ import annotations

import math

import pytest
from tests.cases import each_case
from tests.edge.delays import Link, Simulated, during, simulated, steady, wireless

pytestmark = pytest.mark.slow

BACK_S = 20.0
DELAY_S, OWN_S = 0.02, 0.03  # of a link; from the middle of a slot until its orders leave
SITE = (steady(DELAY_S),) * 3
RATES = each_case("rate", [6.0, 12.5, 25.0])


def need(rate: float, delay_s: float = DELAY_S) -> int:
    """The least lead at which orders come a tenth of a slot before theirs begins."""
    return max(math.ceil((delay_s + OWN_S) * rate + 0.6 - 1e-9), 1)


def run(rate: float, *links: Link, seconds: float = 120.0, **more: object) -> Simulated:
    return simulated(links or SITE, rate, seconds, own_s=OWN_S, **more)  # type: ignore[arg-type]


@RATES
def test_steady_delays_leave_the_lead_alone(rate: float) -> None:
    found = run(rate, seconds=300)
    assert found.leads[-1] == need(rate) and found.late_share() == 0.0
    assert found.changes(BACK_S) == 0


@RATES
@each_case("long_s", [2.0, 10.0])
def test_delays_of_the_start_are_forgotten(rate: float, long_s: float) -> None:
    found = run(rate, *(during(0, long_s, 1.9, DELAY_S),) * 3)
    assert found.back_s(long_s, need(rate)) <= BACK_S
    assert found.late_share(long_s + 2.0) == 0.0
    assert found.changes(long_s + BACK_S) == 0


@RATES
@each_case("long_s", [0.4, 1.0, 2.0, 5.0, 30.0])
def test_stall_of_the_edge_does_not_move_the_lead(rate: float, long_s: float) -> None:
    found = run(rate, stalls=((60, 60 + long_s),))
    assert found.changes(BACK_S) == 0 and found.leads[-1] == need(rate)
    assert found.late_share(60 + long_s) == 0.0


@RATES
def test_stall_of_the_edge_each_minute_does_not_move_the_lead(rate: float) -> None:
    found = run(rate, seconds=300, stalls=tuple((60.0 * k, 60.0 * k + 2) for k in range(1, 5)))
    assert found.changes(BACK_S) == 0 and found.leads[-1] == need(rate)
    assert found.late_share() <= 4 * 2 / 300 + 1e-3  # those of the stalls themselves


@RATES
def test_short_pauses_of_the_links_do_not_move_the_lead(rate: float) -> None:
    found = run(rate, seconds=300, pauses=tuple((60.0 * k, 60.0 * k + 1) for k in range(1, 5)))
    assert found.changes(BACK_S) == 0 and found.leads[-1] == need(rate)
    assert found.late_share() <= 4 * 1 / 300 + 1e-3


@RATES
@each_case("disturbed_s", [0.06, 0.15, 0.5, 1.9])
def test_lead_is_back_soon_after_slow_links(rate: float, disturbed_s: float) -> None:
    """It went from 51 to 5 slots in eight minutes, a slot at a time."""
    found = run(rate, *(during(60, 90, disturbed_s, DELAY_S),) * 3, seconds=150)
    assert found.leads[found.times_s < 90][-1] == max(need(rate, disturbed_s), need(rate))
    assert found.back_s(90, need(rate)) <= BACK_S
    assert found.late_share(62.5 + disturbed_s, 90) == 0.0 and found.late_share(90) == 0.0
    assert found.changes(60) <= 8


@RATES
def test_links_that_stay_slower_are_followed_for_good(rate: float) -> None:
    found = run(rate, *(during(60, math.inf, 0.3, DELAY_S),) * 3, seconds=300)
    assert found.leads[-1] == need(rate, 0.3)
    assert found.late_share(62.5) == 0.0 and found.changes(60) == 1


@each_case("rate, spread, seed", [(6.0, 0.5, 0), (12.5, 0.8, 10), (25.0, 1.2, 20)])
def test_links_that_vary_do_not_make_the_lead_oscillate(
    rate: float, spread: float, seed: int
) -> None:
    links = tuple(wireless(seed + camera, spread=spread) for camera in range(3))
    found = run(rate, *links, seconds=900)
    assert found.changes(300) <= 10  # one per minute
    assert found.late_share() <= 0.02


@RATES
def test_one_link_of_two_that_varies(rate: float) -> None:
    found = run(rate, steady(DELAY_S), wireless(3), seconds=600)
    assert found.changes(300) <= 3
    assert found.late[:, 0].sum() == 0 and found.late[:, 1].mean() <= 0.02


@RATES
def test_lead_is_back_after_one_of_two_links_was_slow(rate: float) -> None:
    found = run(rate, steady(DELAY_S), during(60, 90, 0.45, DELAY_S), seconds=150)
    assert found.leads.max() >= need(rate, 0.45)
    assert found.back_s(90, need(rate)) <= BACK_S
