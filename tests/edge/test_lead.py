"""The lead is the smallest that makes orders arrive in time, and it does not flutter."""

from __future__ import annotations

import math

import numpy as np
import pytest

from e3pose.edge.lead import CALM_SLOTS, MAX_LEAD, MAX_SAMPLES, Lead, adapt, cautious, take_in_delay

INTERVAL_S = 0.04


def settled(delay_s: float, wake_s: float = 0.0, start: int = 1) -> Lead:
    lead = Lead(start)
    for _ in range(40):
        lead = take_in_delay(lead, delay_s)
    for _ in range(CALM_SLOTS * (start + 2)):
        lead = adapt(lead, INTERVAL_S, wake_s)
    return lead


@pytest.mark.parametrize(
    ("delay_ms", "slots"), [(1, 1), (15, 1), (17, 2), (50, 2), (57, 3), (200, 6), (1000, 26)]
)
def test_order_arrives_just_before_its_slot_begins(delay_ms: float, slots: int) -> None:
    assert settled(delay_ms / 1000).slots == slots
    margin_s = (slots - 0.5) * INTERVAL_S - delay_ms / 1000  # law: in time, and one less is not
    assert margin_s >= 0.1 * INTERVAL_S - 1e-9
    assert slots == 1 or margin_s - INTERVAL_S < 0.1 * INTERVAL_S


def test_growing_is_immediate_and_shrinking_waits() -> None:
    lead = settled(0.001)
    for _ in range(500):
        lead = take_in_delay(lead, 0.1)
    lead = adapt(lead, INTERVAL_S)
    assert lead.slots == 4
    for _ in range(500):
        lead = take_in_delay(lead, 0.001)
    for _ in range(CALM_SLOTS - 1):
        lead = adapt(lead, INTERVAL_S)
        assert lead.slots == 4
    assert adapt(lead, INTERVAL_S).slots == 3


def test_slow_air_counts_within_two_seconds() -> None:
    """Five cameras say their longest delay twice a second."""
    lead = settled(0.01)
    for _ in range(1000):
        lead = take_in_delay(lead, 0.01)
    for _ in range(5 * 2 * 2):
        lead = take_in_delay(lead, 0.15)
    assert adapt(lead, INTERVAL_S).slots == 5


def test_delay_that_flutters_does_not_make_the_lead_flutter() -> None:
    rng = np.random.default_rng(1)
    lead, changes = Lead(1), 0
    for _ in range(5000):
        lead = take_in_delay(lead, float(rng.choice([0.01, 0.018])))
        before = lead.slots
        lead = adapt(lead, INTERVAL_S)
        changes += lead.slots != before
    assert changes == 1 and lead.slots == 2


def test_cameras_that_sleep_are_given_time_to_wake() -> None:
    assert settled(0.001, wake_s=0.4).slots == 11


@pytest.mark.parametrize("delay_s", [math.nan, math.inf, -1.0, 1e9])
def test_delay_that_cannot_be_is_ignored(delay_s: float) -> None:
    assert take_in_delay(Lead(), delay_s) == Lead()


def test_lead_is_bounded_and_so_is_its_memory() -> None:
    lead = settled(3000.0)
    assert lead.slots == MAX_LEAD
    for _ in range(2000):
        lead = take_in_delay(lead, 0.01)
    assert len(lead.delays_s) == MAX_SAMPLES


def test_beginning_survives_slots_that_wait_for_their_deadline() -> None:
    assert cautious(0.12, INTERVAL_S).slots == 4
    assert cautious(0.0, INTERVAL_S).slots == 1
