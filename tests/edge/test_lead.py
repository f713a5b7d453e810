"""The lead is the smallest that makes orders arrive in time, and it does not flutter."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.edge.lead import (
    LONGEST_STALL_S,
    MAX_DELAY_S,
    MAX_SAMPLES,
    MIN_SAMPLES,
    STALL_QUIET_S,
    Lead,
    adapt,
    cautious,
    lagging,
    take_in_delay,
    with_edge_delay,
)

INTERVAL_S = 0.04


def settled(delay_s: float, wake_s: float = 0.0, start: int = 1) -> Lead:
    lead = Lead(start)
    for _ in range(40):
        lead = take_in_delay(lead, 0, delay_s)
    for _ in range(round(20 / INTERVAL_S)):
        lead = adapt(lead, INTERVAL_S, wake_s)
    return lead


@each_case(("count", "left_out"), [(MIN_SAMPLES, 0), (11, 1), (MAX_SAMPLES, 3)])
def test_longest_delay_leaves_out_one_report_in_ten(count: int, left_out: int) -> None:
    delays_s = np.random.default_rng(count).uniform(0.1, 0.2, size=count)
    lead = Lead()
    for delay_s in delays_s.tolist():
        lead = take_in_delay(lead, 0, delay_s)
    assert lead.longest_s[0] == sorted(delays_s.tolist())[-1 - left_out]


@each_case(
    ("delay_ms", "slots"), [(1, 1), (15, 1), (17, 2), (50, 2), (57, 3), (200, 6), (1000, 26)]
)
def test_order_arrives_just_before_its_slot_begins(delay_ms: float, slots: int) -> None:
    assert settled(delay_ms / 1000).slots == slots
    margin_s = (slots - 0.5) * INTERVAL_S - delay_ms / 1000  # law: in time, and one less is not
    assert margin_s >= 0.1 * INTERVAL_S - 1e-9
    assert slots == 1 or margin_s - INTERVAL_S < 0.1 * INTERVAL_S


def test_an_edge_that_stays_late_is_slow_and_followed() -> None:
    lead = Lead()
    for _ in range(round((LONGEST_STALL_S + STALL_QUIET_S + 5.0) / INTERVAL_S)):
        lead = with_edge_delay(lead, 0.5, INTERVAL_S)
        lead = adapt(take_in_delay(lead, 0, 0.6), INTERVAL_S)
    assert lead.slots == 16


def test_cameras_that_sleep_are_given_time_to_wake() -> None:
    assert settled(0.001, wake_s=0.4).slots == 11


@each_case("delay_s", [math.nan, math.inf, -1.0])
def test_delay_that_cannot_be_is_ignored(delay_s: float) -> None:
    assert take_in_delay(Lead(), 0, delay_s) == Lead()


def after_delays(lead: Lead, delays_s: list[float]) -> Lead:
    """Every camera reports a delay."""
    for camera, delay_s in enumerate(delays_s):
        lead = take_in_delay(lead, camera, delay_s)
    return lead


def followed(*delays_s: float, online: list[bool] | None = None) -> Lead:
    """The lead after cameras have reported these delays for a while."""
    lead = Lead()
    for _ in range(MIN_SAMPLES):
        lead = after_delays(lead, list(delays_s))
    return adapt(lead, INTERVAL_S, online=online)


@each_case("lie_s", [0.6, 1.9, 3.0, 3000.0])
def test_a_camera_far_slower_than_the_others_is_left_behind(lie_s: float) -> None:
    lead = followed(0.01, 0.02, lie_s, 0.015)
    assert lead.slots == followed(0.01, 0.02, 0.015).slots
    assert lead.left_behind == (2,)


def test_a_camera_somewhat_slower_is_followed() -> None:
    lead = followed(0.01, 0.02, 0.3, 0.015)
    assert lead.left_behind == ()
    assert lead.slots == 9


def test_a_site_of_slow_links_is_followed() -> None:
    lead = followed(0.02, 0.8, 0.9, 0.85)
    assert lead.left_behind == ()
    assert lead.slots == 24


def test_cameras_that_are_away_do_not_count() -> None:
    assert followed(0.01, 0.02, 0.3, online=[True, True, False]).slots == 2
    assert followed(0.01, online=[False]) == followed(0.01, online=[False])


def test_who_comes_back_is_not_judged_by_what_it_was() -> None:
    lead = followed(0.01, 0.02, 3.0)
    assert lagging(lead)[2].startswith("too slow: orders take 3.0 s")
    lead = adapt(lead, INTERVAL_S, online=[True, True, False])
    assert lagging(lead) == {}
    for _ in range(MIN_SAMPLES):
        lead = take_in_delay(lead, 2, 0.02)
    lead = adapt(lead, INTERVAL_S, online=[True, True, True])
    assert lagging(lead) == {} and lead.longest_s[2] == pytest.approx(0.02)


def test_lead_is_bounded_and_so_is_its_memory() -> None:
    assert followed(3000.0).slots == 1  # nobody is worth following
    assert followed(1.99, 1.99).slots <= round(MAX_DELAY_S / INTERVAL_S) + 2
    lead = settled(0.01)
    for _ in range(2000):
        lead = take_in_delay(lead, 0, 0.01)
    assert [len(delays_s) for delays_s in lead.delays_s] == [MAX_SAMPLES]


def test_beginning_survives_slots_that_wait_for_their_deadline() -> None:
    assert cautious(0.12, INTERVAL_S).slots == 4
    assert cautious(0.0, INTERVAL_S).slots == 1
