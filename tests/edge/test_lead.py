"""The lead is the smallest that makes orders arrive in time, whatever a camera claims."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.edge.camera_state import RELIABLE, SHARE_ORDERS, Answers, followed
from e3pose.edge.lead import (
    FAR_S,
    LONGEST_STALL_S,
    MAX_DELAY_S,
    MAX_SAMPLES,
    MIN_SAMPLES,
    STALL_QUIET_S,
    Lead,
    adapt,
    believed_wakes_s,
    cautious,
    lagging,
    lead_for,
    take_in_delay,
    with_claims,
    with_edge_delay,
)
from e3pose.select.failure_detector import Silence

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
    assert settled(0.001, wake_s=0.4).slots == 11  # cameras that sleep have time to wake


def test_an_edge_that_stays_late_is_slow_and_followed() -> None:
    lead = Lead()
    for _ in range(round((LONGEST_STALL_S + STALL_QUIET_S + 5.0) / INTERVAL_S)):
        lead = with_edge_delay(lead, 0.5, INTERVAL_S)
        lead = adapt(take_in_delay(lead, 0, 0.6), INTERVAL_S)
    assert lead.slots == 16


@each_case("delay_s", [math.nan, math.inf, -1.0])
def test_delay_that_cannot_be_is_ignored(delay_s: float) -> None:
    assert take_in_delay(Lead(), 0, delay_s) == Lead()


def after_delays(lead: Lead, delays_s: list[float]) -> Lead:
    """Every camera reports a delay."""
    for camera, delay_s in enumerate(delays_s):
        lead = take_in_delay(lead, camera, delay_s)
    return lead


def is_followed(*delays_s: float, online: list[bool] | None = None) -> Lead:
    """The lead after cameras have reported these delays for a while."""
    lead = Lead()
    for _ in range(MIN_SAMPLES):
        lead = after_delays(lead, list(delays_s))
    return adapt(lead, INTERVAL_S, online=online)


@each_case("lie_s", [0.6, 1.9, 3.0, 3000.0])
def test_a_camera_far_slower_than_the_others_is_left_behind(lie_s: float) -> None:
    lead = is_followed(0.01, 0.02, lie_s, 0.015)
    assert lead.slots == is_followed(0.01, 0.02, 0.015).slots
    assert lead.left_behind == (2,)


def test_a_camera_somewhat_slower_and_a_site_of_slow_links_are_followed_unless_away() -> None:
    for delays_s, slots in (((0.01, 0.02, 0.3, 0.015), 9), ((0.02, 0.8, 0.9, 0.85), 24)):
        lead = is_followed(*delays_s)
        assert (lead.left_behind, lead.slots) == ((), slots)
    assert is_followed(0.01, 0.02, 0.3, online=[True, True, False]).slots == 2


def test_who_comes_back_is_not_judged_by_what_it_was() -> None:
    lead = is_followed(0.01, 0.02, 3.0)
    assert lagging(lead)[2].startswith("too slow: orders take 3.0 s")
    lead = adapt(lead, INTERVAL_S, online=[True, True, False])
    assert lagging(lead) == {}
    for _ in range(MIN_SAMPLES):
        lead = take_in_delay(lead, 2, 0.02)
    lead = adapt(lead, INTERVAL_S, online=[True, True, True])
    assert lagging(lead) == {} and lead.longest_s[2] == pytest.approx(0.02)


def test_lead_is_bounded_and_so_is_its_memory() -> None:
    assert is_followed(3000.0).slots == 1  # nobody is worth following
    assert is_followed(1.99, 1.99).slots <= round(MAX_DELAY_S / INTERVAL_S) + 2
    lead = settled(0.01)
    for _ in range(2000):
        lead = take_in_delay(lead, 0, 0.01)
    assert [len(delays_s) for delays_s in lead.delays_s] == [MAX_SAMPLES]


def test_beginning_survives_slots_that_wait_for_their_deadline() -> None:
    assert cautious(0.12, INTERVAL_S).slots == 4
    assert cautious(0.0, INTERVAL_S).slots == 1


def leads(
    claims_s: list[float], answers: list[float], seconds: float = 60.0, start: int = 2
) -> list[int]:
    """Return the lead over time while four cameras say their delays and answer so many orders."""
    share, lead, found = np.ones(4), Lead(start), []
    rng = np.random.default_rng(1)
    for slot in range(round(seconds / INTERVAL_S)):
        claims = list(enumerate(claims_s)) if slot % 12 == 0 else []
        share = share + ((rng.uniform(size=4) < answers) - share) / SHARE_ORDERS
        lead = with_claims(lead, claims, share, INTERVAL_S)
        lead = adapt(lead, INTERVAL_S, online=[True] * 4)
        found.append(lead.slots)
    return found


HONEST_S = [0.01, 0.02, 0.015, 0.03]


@each_case("lie_s", [0.1, 0.3, 0.5, 0.6, 1.9, 3600.0])
@each_case("liars", [1, 2])
def test_delays_of_cameras_that_answer_do_not_move_the_lead(lie_s: float, liars: int) -> None:
    usual = leads(HONEST_S, [1.0] * 4)
    lied = leads([*HONEST_S[: 4 - liars], *[lie_s] * liars], [1.0] * 4)
    assert max(lied) <= max(usual) + 1


@pytest.mark.parametrize("liars", [1, 2])
def test_delays_far_from_the_others_do_not_move_the_lead(liars: int) -> None:
    lied = leads([*HONEST_S[: 4 - liars], *[1.9] * liars], [*[1.0] * (4 - liars), *[0.0] * liars])
    assert max(lied) <= max(leads(HONEST_S, [1.0] * 4)) + 1


def test_one_slower_than_the_next_is_measured_from_the_others() -> None:
    limit = round((HONEST_S[1] + FAR_S) / INTERVAL_S) + 2
    assert max(leads([0.01, 0.02, 0.4, 0.9], [1.0, 1.0, 0.0, 0.0])) <= limit


def test_camera_that_misses_orders_is_followed() -> None:
    assert leads([0.01, 0.02, 0.015, 0.3], [1.0, 1.0, 1.0, 0.3])[-1] == 9
    assert leads([0.3] * 4, [1.0] * 4)[-1] == 9  # what all say is usual


def test_lead_that_only_a_word_holds_shrinks() -> None:
    held = leads([*HONEST_S[:3], 0.4], [1.0] * 4, seconds=120.0, start=11)
    assert held[-1] <= 6


def test_camera_that_is_given_up_again_and_again_is_not_followed() -> None:
    silence = replace(Silence.none(5), failures=np.arange(5))
    answers = Answers.none(5)
    assert followed(answers, silence).tolist() == [True, True, True, False, False]
    answers = replace(answers, share=np.array([RELIABLE - 0.1, *[1.0] * 4]))
    assert not followed(answers, Silence.none(5))[0]


def test_delays_of_cameras_that_are_not_followed_move_nothing() -> None:
    counted, lead = [True, True, False, False], Lead(2)
    claims = list(enumerate([0.02, 0.03, 0.4, 0.4]))
    for _ in range(8):
        lead = with_claims(lead, claims, np.full(4, 0.6), INTERVAL_S, followed=counted)
        lead = adapt(lead, INTERVAL_S, online=[True] * 4, followed=counted)
        assert lead.slots == 2
    # They are known all the same, for the day on which the camera is followed again.
    assert adapt(lead, INTERVAL_S, online=[True] * 4).slots == 11


@each_case("lie_s", [0.6, 3.0, 3600.0])
@each_case("liars", [1, 2])
def test_wake_up_times_are_those_of_the_site(lie_s: float, liars: int) -> None:
    claims_s = [*[0.4] * (4 - liars), *[lie_s] * liars]
    share = np.ones(4)
    assert believed_wakes_s(claims_s, [0.5] * 4, share).max() == pytest.approx(0.5)
    share[-liars:] = 0.0  # they answer nothing
    assert believed_wakes_s(claims_s, [0.5] * 4, share).max() <= MAX_DELAY_S
    assert not believed_wakes_s([None, None], [0.5, 0.5], np.ones(2)).any()  # they never sleep


def test_delays_that_most_cameras_have_are_blamed_on_none() -> None:
    one = lagging(Lead(longest_s=(0.1, 0.1, 3.0), left_behind=(2,)))
    assert list(one) == [2] and one[2].endswith("far longer than for the others")
    every = lagging(Lead(longest_s=(2.5, 2.6, 3.0), left_behind=(0, 1, 2)))
    assert every[0] == "orders take 2.5 s to arrive, as for most cameras: check the network"
    assert not any("others" in why for why in every.values())


def test_orders_for_a_slow_camera_leave_earlier() -> None:
    lead, interval_s = Lead(2, longest_s=(0.05, 0.06, 0.4, 3.0)), 0.1
    assert [lead_for(lead, camera, interval_s) for camera in range(4)] == [2, 2, 5, 7]
    limit_s = 0.06 + FAR_S
    assert np.ceil(limit_s / interval_s + 0.6) == 7  # no camera is tried later than followed
    assert lead_for(lead, 0, interval_s, wake_s=1.0) == 12
    assert lead_for(Lead(4), 0, interval_s) == 4  # before any report
