"""A camera's word moves the lead as far as the edge sees no reason to doubt it."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.arrays import Flags
from e3pose.edge.credibility import (
    AWAITED,
    EXCUSED_S,
    MEMORY_ORDERS,
    NEWEST_AGES,
    PATIENCE,
    SELDOM_S,
    SILENT_ORDERS,
    Credibility,
)
from e3pose.edge.lead import FAR_S, MAX_DELAY_S, Lead, adapt, lower_median
from e3pose.edge.trials import RELIABLE

INTERVAL_S = 0.04
AGE_S, DEADLINE_S = 0.02, 0.12  # of views; of slots
ALL = np.ones(4, dtype=bool)
views = np.zeros(4, dtype=np.int64)  # that came so far


def observe(credibility: Credibility, slot: int, arrived: Flags) -> None:
    """Add a slot for which all cameras were ordered, and some answered."""
    views[:] += arrived
    ages_s = dict.fromkeys(np.flatnonzero(arrived).tolist(), AGE_S)
    credibility.observe(slot, ALL, ALL, ages_s, views)


def leads(
    claims_s: list[float], answers: list[float], seconds: float = 60.0, start: int = 2
) -> list[int]:
    """Return the lead over time while four cameras say their delays and answer so many orders."""
    credibility, lead, found = Credibility(4, INTERVAL_S), Lead(start), []
    rng = np.random.default_rng(1)
    for slot in range(round(seconds / INTERVAL_S)):
        if slot % 12 == 0:
            for camera, claim_s in enumerate(claims_s):
                credibility.claim(camera, claim_s)
        observe(credibility, slot, rng.uniform(size=4) < answers)
        lead = adapt(credibility.lead_after_claims(lead), INTERVAL_S, online=[True] * 4)
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
    credibility = Credibility(5, INTERVAL_S)
    assert credibility.followed(np.arange(5)).tolist() == [True, True, True, False, False]
    credibility.share[0] = RELIABLE - 0.1
    assert not credibility.followed(np.zeros(5, dtype=np.int64))[0]


def test_delays_of_cameras_that_are_not_followed_move_nothing() -> None:
    followed, lead = [True, True, False, False], Lead(2)
    credibility = Credibility(4, INTERVAL_S)
    credibility.share[:] = 0.6
    for _ in range(8):
        for camera, claim_s in enumerate([0.02, 0.03, 0.4, 0.4]):
            credibility.claim(camera, claim_s)
        lead = credibility.lead_after_claims(lead, followed=followed)
        lead = adapt(lead, INTERVAL_S, online=[True] * 4, followed=followed)
        assert lead.slots == 2
    # They are known all the same, for the day on which the camera is followed again.
    assert adapt(lead, INTERVAL_S, online=[True] * 4).slots == 11


def test_late_orders_excuse_a_camera_for_some_seconds() -> None:
    credibility, late = Credibility(4, INTERVAL_S), np.array([True, False, False, True])
    excused = []
    for slot in range(400):
        observe(credibility, slot, np.array([False, False, True, True]))
        excused.append(credibility.excused(late))
    assert excused[0].tolist() == late.tolist()
    assert sum(each[0] for each in excused) == pytest.approx(EXCUSED_S / INTERVAL_S, abs=1)
    assert all(each[3] for each in excused)  # its views arrive


def test_cameras_that_seldom_answer_are_not_selected() -> None:
    credibility = Credibility(4, INTERVAL_S)
    credibility.share = np.array([1.0, 0.9, RELIABLE - 0.1, 0.0])
    assert credibility.usable(ALL).tolist() == [True, True, False, False]
    # Two cameras are needed: without the second one all are used.
    assert credibility.usable(np.array([True, False, True, True])).all()


def test_slots_wait_for_cameras_that_answer_most_orders() -> None:
    credibility = Credibility(4, INTERVAL_S)
    observe(credibility, 0, ALL)
    credibility.share = np.array([1.0, AWAITED, AWAITED - 0.1, RELIABLE - 0.1])
    ordered = np.array([True, True, True, False])
    usual_s = PATIENCE * AGE_S
    waits_s = credibility.waits_s(ordered, ALL, DEADLINE_S)
    np.testing.assert_allclose(waits_s, [DEADLINE_S, DEADLINE_S, usual_s, 0.0])
    assert credibility.waits_s(ALL, ordered, DEADLINE_S)[3] == 0.0  # it cannot be reached
    views[2] += 1  # late, so that the usual time is too short
    observe(credibility, 1, ~ordered)
    assert credibility.waits_s(ALL, ALL, DEADLINE_S)[2] == DEADLINE_S
    for slot in range(2, 2 + NEWEST_AGES):
        observe(credibility, slot, ALL)
    credibility.share[2] = AWAITED - 0.1
    assert credibility.waits_s(ALL, ALL, DEADLINE_S)[2] == pytest.approx(usual_s)


def test_slots_do_not_wait_for_silent_cameras_until_a_view_comes() -> None:
    credibility, three = Credibility(4, INTERVAL_S), np.array([True, True, True, False])
    observe(credibility, -1, ALL)
    waited = []
    for slot in range(20):
        waited.append(bool(credibility.waits_s(ALL, ALL, DEADLINE_S)[3]))
        observe(credibility, slot, three)
    assert waited == [True] * SILENT_ORDERS + [False] * (20 - SILENT_ORDERS)
    views[3] += 1  # late, so that none arrived in time
    observe(credibility, 20, three)
    assert credibility.waits_s(ALL, ALL, DEADLINE_S)[3] == DEADLINE_S


def test_slots_without_any_view_blame_no_camera() -> None:
    credibility, none = Credibility(4, INTERVAL_S), np.zeros(4, dtype=bool)
    for slot in range(1000):
        observe(credibility, slot, none)
    assert (credibility.share == 1).all()  # the edge was not ready
    observe(credibility, 1000, ALL)
    for slot in range(1000):
        observe(credibility, slot, none)
    assert (credibility.share > 0.7).all()


def test_camera_that_seldom_answers_is_told_until_it_answers_again() -> None:
    credibility = Credibility(4, INTERVAL_S)
    three = np.array([True, True, True, False])
    for slot in range(MEMORY_ORDERS):
        observe(credibility, slot, three)
    assert credibility.share[3] < RELIABLE
    in_time = np.full(4, np.nan)
    assert credibility.impairments([""] * 4, in_time) == [""] * 4  # perhaps for a moment only
    for slot in range(MEMORY_ORDERS, MEMORY_ORDERS + round(SELDOM_S / INTERVAL_S)):
        observe(credibility, slot, three)
    said = credibility.impairments(["broken", "", "", ""], in_time)
    assert said == ["broken", "", "", f"answers {credibility.share[3]:.0%} of its orders in time"]
    late_s = np.array([np.nan, 0.2, np.nan, 0.2])
    said = credibility.impairments([""] * 4, late_s)
    assert said == ["", "", "", "views arrive too late, 200 ms after capture"]
    for slot in range(20 * MEMORY_ORDERS):
        observe(credibility, slot, ALL)
    assert credibility.share[3] > RELIABLE
    assert credibility.impairments([""] * 4, in_time) == [""] * 4


@each_case("lie_s", [0.6, 3.0, 3600.0])
@each_case("liars", [1, 2])
def test_wake_up_times_are_those_of_the_site(lie_s: float, liars: int) -> None:
    credibility = Credibility(4, INTERVAL_S, [0.5] * 4)
    claims_s = [*[0.4] * (4 - liars), *[lie_s] * liars]
    assert credibility.wake_s(claims_s) == pytest.approx(0.5)
    credibility.share[-liars:] = 0.0  # they answer nothing
    assert credibility.wake_s(claims_s) <= MAX_DELAY_S


def test_cameras_that_never_sleep_need_no_time_to_wake() -> None:
    assert Credibility(2, INTERVAL_S).wake_s([None, None]) == 0.0


def test_lower_median_is_not_raised_by_half() -> None:
    assert lower_median([1.0]) == 1.0
    assert lower_median([9.0, 1.0]) == 1.0
    assert lower_median([9.0, 1.0, 9.0, 2.0]) == 2.0
