"""How cameras answer their orders: whom slots wait for, who is tried, named, and forgiven."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.arrays import Flags, Integers
from e3pose.edge import camera_state as cameras
from e3pose.edge.camera_state import (
    Answers,
    CameraState,
    State,
    shortages,
    waits_s,
    with_heartbeat,
    with_hello,
)
from e3pose.edge.lead import Lead
from e3pose.edge.reports import changes
from e3pose.select.failure_detector import Silence, listen
from e3pose.wire.messages import Heartbeat, Hello

INTERVAL_S = 0.04
AGE_S, DEADLINE_S = 0.02, 0.12  # of views; of slots
ALL, NOBODY = np.ones(4, dtype=bool), np.zeros(4, dtype=bool)
READY = np.full(4, State.READY)


def answered(
    answers: Answers,
    arrived: Flags,
    late: Flags = NOBODY,
    ordered: Flags = ALL,
    given_up: Flags = NOBODY,
    states: Integers = READY,
    fair: bool = True,
) -> Answers:
    """Return the answers after one more slot, in which some views came in time and some late."""
    turn = cameras.Turn(
        states=states,
        ordered=ordered,
        ages_s=np.where(arrived, AGE_S, np.nan),
        views=answers.views + arrived + late,
        late=answers.late + late,
        views_late=late,
        orders_late=NOBODY,
    )
    return cameras.after_slot(answers, turn, given_up, INTERVAL_S, fair)


def but(*cameras: int) -> Flags:
    """Return all cameras but some."""
    return ~np.isin(np.arange(4), cameras)


def shares(*share: float) -> Answers:
    return replace(Answers.none(4), share=np.array(share))


# Who counts, and who is waited for.


def test_late_orders_excuse_a_camera_for_some_seconds() -> None:
    answers, late = Answers.none(4), np.array([True, False, False, True])
    found = []
    for _ in range(400):
        answers = answered(answers, but(0, 1))
        found.append(cameras.excused(answers, late))
    assert found[0].tolist() == late.tolist()
    assert sum(each[0] for each in found) == pytest.approx(5 / INTERVAL_S, abs=1)
    assert all(each[3] for each in found)  # its views arrive


def test_cameras_that_seldom_answer_are_on_trial() -> None:
    answers = shares(1.0, 0.41, 0.39, 0.0)
    found = cameras.states_of(READY, answers, but(1))
    assert found.tolist() == [State.READY, State.SUSPECTED, State.ON_TRIAL, State.ON_TRIAL]
    # Two cameras are needed: without the second one all are used.
    away = np.where(but(1), READY, State.LEFT)
    assert cameras.states_of(away, answers, ALL).tolist() == away.tolist()


def test_slots_wait_for_cameras_that_answer_most_orders() -> None:
    answers = replace(
        answered(Answers.none(4), ALL),
        share=np.array([1.0, 0.75, 0.74, 0.39]),
    )
    usual_s = 1.5 * AGE_S
    found = waits_s(answers, but(3), DEADLINE_S)
    np.testing.assert_allclose(found, [DEADLINE_S, DEADLINE_S, usual_s, 0.0])
    answers = answered(answers, but(0, 1, 2), late=~but(2))  # so that the usual time is too short
    assert waits_s(answers, ALL, DEADLINE_S)[2] == DEADLINE_S
    for _ in range(cameras.NEWEST_AGES):
        answers = answered(answers, ALL)
    answers = replace(answers, share=np.full(4, 0.74))
    assert waits_s(answers, ALL, DEADLINE_S)[2] == pytest.approx(usual_s)
    assert waits_s(shares(0, 0, 0, 0), ALL, DEADLINE_S)[0] == DEADLINE_S  # before its first view


def test_slots_do_not_wait_for_silent_cameras_until_a_view_comes() -> None:
    answers, waited = answered(Answers.none(4), ALL), []
    for _ in range(20):
        waited.append(bool(waits_s(answers, ALL, DEADLINE_S)[3]))
        answers = answered(answers, but(3))
    assert waited == [True] * 5 + [False] * 15
    answers = answered(answers, but(3), late=~but(3))
    assert waits_s(answers, ALL, DEADLINE_S)[3] == DEADLINE_S


def test_slots_without_any_view_blame_no_camera() -> None:
    answers = Answers.none(4)
    for _ in range(1000):
        answers = answered(answers, NOBODY)
    assert (answers.share == 1).all()  # the edge was not ready
    answers = answered(answers, ALL)
    for _ in range(1000):
        answers = answered(answers, NOBODY)
    assert (answers.share > 0.7).all()


def test_cameras_are_forgiven_once_the_edge_was_to_blame() -> None:
    answers = answered(Answers.none(4), ALL)
    for _ in range(200):
        answers = answered(answers, but(3))
    new = answers.forgiven()
    assert new.share[3] == 1 and not new.silent.any() and not new.seldom_s.any()
    assert not new.orders.any(), "what they deliver is counted anew"
    assert answered(new, NOBODY).silent.all(), "views that came before are no new ones"


# Trials.


def test_cameras_on_trial_are_ordered_one_by_one_more_and_more_rarely() -> None:
    interval_s, seconds = 0.1, 200.0
    answers, found = shares(1.0, 1.0, 0.0, 0.0), []
    states = cameras.states_of(READY, answers, ALL)
    for slot in range(round(seconds / interval_s)):
        answers = replace(answers, seldom_s=np.array([0, 0, slot * interval_s, 0.0]))
        found.append(cameras.tried(answers, states, slot, interval_s))
    orders = np.array(found)
    assert not orders[:, :2].any() and (orders.sum(axis=1) <= 1).all()
    assert orders[:, 3].mean() == pytest.approx(0.1, abs=0.01)
    begins_s = np.flatnonzero(np.diff(orders[:, 2].astype(int)) > 0) * interval_s
    assert begins_s[0] <= 10
    assert np.round(np.diff(begins_s)).max() == 40
    assert not cameras.tried(answers, READY, 0, interval_s).any()


# What operators are told.


def told(answers: Answers, late_by_s: float = np.nan, newest_late: Flags = NOBODY) -> list[str]:
    ages_s = np.where(but(0, 2), late_by_s, np.nan)
    return cameras.impairments(answers, Silence.none(4), Lead(), ages_s, newest_late, INTERVAL_S)


def test_camera_that_seldom_answers_is_told_until_it_answers_again() -> None:
    answers, seldom = answered(Answers.none(4), ALL), 0
    while told(answers) == [""] * 4:  # perhaps for a moment only
        answers = answered(answers, but(3))
        seldom += answers.share[3] < 0.4
    assert seldom * INTERVAL_S == pytest.approx(5.0, abs=INTERVAL_S)
    said = f"answers {answers.share[3]:.0%} of its orders in time"
    assert told(answers) == ["", "", "", said]
    assert told(answers, 0.2) == ["", "", "", said]  # its late views are long ago
    assert told(answers, 0.2, ALL)[3] == "views arrive too late, 200 ms after capture"
    away = answered(answers, but(3), states=np.where(but(3), READY, State.LEFT))
    assert away.seldom_s[3] == answers.seldom_s[3]  # of one that is away nothing is known
    for _ in range(640):
        answers = answered(answers, ALL)
    assert answers.share[3] > 0.4 and told(answers) == [""] * 4


@each_case("late", [True, False])
def test_camera_that_fails_again_when_tried_again_is_reported(late: bool) -> None:
    answers, silence, slot = Answers.none(4), Silence.none(4), 0
    late_by_s = np.array([np.nan, 0.232 if late else np.nan, np.nan, np.nan])

    def said() -> list[str]:
        return cameras.impairments(answers, silence, Lead(), late_by_s, NOBODY, INTERVAL_S)

    failures = 2 if late else 3
    while silence.failures[1] < failures:
        assert said() == [""] * 4
        slot = max(slot + 1, int(silence.retry_slot[1]))
        silence = listen(silence, slot, ALL, but(1), INTERVAL_S)
        if late:
            silence = replace(silence, missed=np.zeros(4, dtype=np.int64))  # it is alive
    assert 1.4 < slot * INTERVAL_S < 5.0
    message = "views arrive too late, 232 ms after capture" if late else "no views arrive in time"
    assert said() == ["", message, "", ""]
    silence = listen(silence, int(silence.retry_slot[1]), ALL, ALL, INTERVAL_S)
    assert said() == [""] * 4


def test_changes_are_reported_once() -> None:
    titles = {"a": "Küche", "b": "b", "c": "c"}
    found = changes(titles, ["", "x", "y"], ["gone", "", "z"], ("lost", "back"))
    assert found == [("lost", "Küche: gone", "a"), ("back", "b connected", "b")]


# Cameras that bring too few of the views ordered of them are named, with figures, and once.


def deliver(share: float, slots: int, before: Answers | None = None) -> list[Answers]:
    """What is known after each slot: all views of the others come, and a share of camera 1's."""
    rng, found = np.random.default_rng(1), [before or Answers.none(4)]
    for _ in range(slots):
        found.append(answered(found[-1], ALL if rng.random() < share else but(1)))
    return found


def test_camera_of_half_the_frames_is_named_within_seconds() -> None:
    found = deliver(0.5, 1000)
    first = next(n for n, each in enumerate(found) if each.short.any())
    assert first * INTERVAL_S <= 3 and found[-1].short.tolist() == [False, True, False, False]
    assert found[-1].delivery(1) == pytest.approx(0.5, abs=0.1) and found[-1].delivery(0) == 1
    assert found[49].delivery(1) is None and found[50].delivery(1) is not None
    assert not deliver(1.0, 2000, found[-1])[-1].short.any()


@each_case("share", [0.9, 0.925])
def test_share_about_the_limit_does_not_flap(share: float) -> None:
    found = deliver(share, round(300 / INTERVAL_S))
    changed_s = [
        n * INTERVAL_S for n, (a, b) in enumerate(pairwise(found)) if (a.short != b.short).any()
    ]
    assert len(changed_s) <= 4


def test_second_warning_comes_twenty_seconds_after_the_first_has_ended() -> None:
    answers, slots = deliver(0.5, 1000)[-1], 0
    assert answers.short[1]
    while answers.short[1]:
        answers = answered(answers, ALL)
    while not answers.short[1]:
        answers, slots = answered(answers, but(1)), slots + 1
    assert slots * INTERVAL_S == pytest.approx(20, abs=0.1)


def test_camera_that_was_given_up_is_counted_anew() -> None:
    gone = deliver(0.1, 1000)[-1]
    assert gone.short[1]
    up = answered(gone, ALL, given_up=~but(1))
    assert up.short[1] and up.delivery(1) is None
    assert shortages(up, [camera(25.0)] * 4, 25.0, 1.0)[1].endswith("its views are counted anew")
    assert not deliver(1.0, 50, up)[-1].short[1]
    assert deliver(1.0, 50, gone)[-1].short[1] and deliver(0.5, 500, up)[-1].short[1]


def test_neither_cameras_without_orders_nor_those_of_a_slow_edge_are_counted() -> None:
    idle, slow = Answers.none(4), Answers.none(4)
    for _ in range(500):
        idle = answered(idle, NOBODY, ordered=NOBODY)
        slow = answered(slow, NOBODY, fair=False)
    assert not idle.orders.any() and not idle.short.any() and not slow.short.any()


def camera(frames_hz: float, dropped_hz: float = 0.0, seconds: int = 9) -> CameraState:
    """A camera that has sent heartbeats for some seconds."""
    state = with_hello(CameraState("cam1"), Hello("cam1", 1, ("nose",), (640, 480), 25.0), 0)
    for half in range(2 * seconds):
        beat = Heartbeat(
            "cam1", 1, 0, "active",
            captured=round(frames_hz * half / 2), dropped=round(dropped_hz * half / 2),
        )  # fmt: skip
        state = with_heartbeat(state, beat, half * 500_000_000)
    return state


def test_message_names_both_figures_and_what_to_do() -> None:
    answers, fine = deliver(0.5, 200)[-1], camera(25.0)

    def said(second: CameraState, pace: float = 1.0, answers: Answers = answers) -> list[str]:
        return shortages(answers, [fine, second, fine, fine], 25.0, pace)

    assert said(camera(12.5, seconds=2)) == [""] * 4  # not known yet
    first, second, *_ = said(camera(12.5))
    assert first == ""
    assert second.startswith("its source brings 12.5 frames per second, the site has 25 slots: ")
    assert "set fps = 12.5 in the site file, or raise the camera's frame rate" in second
    assert "lower pace" in said(camera(12.5), 0.5)[1]
    assert "its detector is too slow" in said(camera(25.0, 12.0))[1]
    assert "check its network connection" in said(fine)[1]
    late = replace(answers, delivered_late=1 - answers.delivered)
    assert "raise deadline_ms" in said(fine, answers=late)[1]


def test_rate_of_frames_is_measured_from_heartbeats() -> None:
    assert camera(12.5).frames_hz == pytest.approx(12.5, abs=0.2)
    assert camera(12.5, seconds=3).frames_hz is None
    state = camera(12.5)
    again = with_hello(state, Hello("cam1", 2, ("nose",), (640, 480), 25.0), 13 * 10**9)
    assert again.frames_hz is None and again.counted is None
    asleep = with_heartbeat(state, Heartbeat("cam1", 1, 0, "aggressive-power-saving"), 13 * 10**9)
    assert asleep.counted is None and asleep.frames_hz == state.frames_hz
