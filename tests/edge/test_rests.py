"""Cameras asleep by order: expected, late, learned, and not mixed up with dead ones."""

from __future__ import annotations

from itertools import count

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.clock import SlotTimes
from e3pose.edge.rests import Rests, WakeTime, sleeps_as_told
from e3pose.edge.roster import CameraState, with_heartbeat, with_presence
from e3pose.wire.messages import Activity, Heartbeat
from e3pose.wire.site_messages import CameraStatus

S = 10**9
TIMES = SlotTimes(0, S // 10)  # ten slots per second
LEAD = 2
CAN = np.array([True, True])


def beat(mode: Activity, session: int = 1) -> Heartbeat:
    return Heartbeat("cam1", session, 0, mode)


def told(until: int = 100, slot: int = 20, wake_s: float = 0.5) -> Rests:
    """Return the rests after camera 1 was told to sleep."""
    rests = Rests([wake_s, wake_s])
    assert rests.order(TIMES, np.array([0, until]), slot, LEAD, CAN).tolist() == [0, until]
    return rests


def state(mode: Activity, heard_ns: int, present: bool = True) -> CameraState:
    camera = with_heartbeat(CameraState("cam1"), beat(mode), heard_ns)
    return camera if present else with_presence(camera, False, heard_ns)


DUE_NS = TIMES.begin_ns(100 - LEAD)


def test_wake_time_is_learned_and_alarms_are_early_by_two_standard_deviations() -> None:
    wake = WakeTime.stated(0.5)
    assert wake.early_s == pytest.approx(0.5 + 2 * 0.25)
    rng = np.random.default_rng(3)
    for took_s in rng.normal(4.0, 0.5, 200):
        wake = wake.after(took_s)
    assert wake.mean_s == pytest.approx(4.0, abs=0.4)
    assert wake.sd_s == pytest.approx(0.5, rel=0.5)
    late = np.mean(rng.normal(4.0, 0.5, 10_000) > wake.early_s)
    assert late < 0.1
    for _ in range(300):
        wake = wake.after(1e9)
    assert wake.early_s <= 60.0  # one that was away for a day is no slow one


def test_camera_asleep_is_expected_back_when_its_next_order_is_made() -> None:
    rests = told()
    rests.heard(1, "cam1", beat("asleep"), 2 * S)
    asleep = state("asleep", 2 * S)
    assert rests.left_s(1, asleep, 4 * S) == pytest.approx((DUE_NS - 4 * S) / S)
    assert rests.words(1, asleep, 4 * S).startswith("asleep for 6 s")
    assert rests.words(1, asleep, DUE_NS + S) == "asleep for 0 s"  # it may still speak
    assert rests.words(1, asleep, DUE_NS + 5 * S) == "overslept by 5 s"
    assert rests.words(0, asleep, 4 * S) == ""  # nobody told that one


def test_camera_that_was_told_and_still_speaks_is_awake() -> None:
    rests = told()
    awake = state("active", 4 * S)
    assert rests.words(1, awake, 4 * S) == ""
    assert rests.words(1, awake, 7 * S).startswith("asleep")  # its last word may be lost


def test_program_that_dies_in_its_sleep_is_dead_and_a_suspended_machine_is_not() -> None:
    rests = told()
    assert rests.words(1, state("asleep", 2 * S, present=False), 4 * S) == ""
    assert rests.words(1, state("suspended", 2 * S, present=False), 4 * S).startswith("asleep")


def test_edge_that_was_restarted_expects_whom_it_never_heard() -> None:
    rests = Rests([0.5, 0.5])
    rests.resume(TIMES, np.array([0, 100]), 20)
    assert rests.words(1, CameraState("cam1"), 4 * S).startswith("asleep")
    assert rests.words(0, CameraState("cam0"), 4 * S) == ""


def test_late_camera_is_told_and_woken_earlier_next_time() -> None:
    rests = told()
    early_s = rests.early_s(1)
    rests.heard(1, "cam1", beat("suspended"), 2 * S)
    rests.heard(1, "cam1", beat("power-saving"), DUE_NS + 3 * S)
    (camera, line), *more = rests.said()
    assert (camera, more) == (1, []) and line.startswith("cam1 overslept by 3.0 s")
    assert rests.wakes[1].mean_s == pytest.approx((0.5 + early_s + 3.0) / 2)
    rests.order(TIMES, np.array([0, 200]), 120, LEAD, CAN)
    assert rests.early_s(1) > early_s + 2
    assert rests.words(1, state("power-saving", DUE_NS + 3 * S), DUE_NS + 3 * S) == ""


def test_wake_in_time_is_learned_and_not_told() -> None:
    rests = told()
    rests.heard(1, "cam1", beat("asleep"), 2 * S)
    rests.heard(1, "cam1", beat("power-saving"), DUE_NS - S // 2)
    assert rests.said() == [] and rests.wakes[1].wakes == 1
    assert rests.wakes[1].mean_s == pytest.approx(0.5)  # its alarm was 1 s early, it took half


def test_camera_that_is_called_before_its_alarm_teaches_nothing() -> None:
    rests = told()
    rests.heard(1, "cam1", beat("asleep"), 2 * S)
    rests.heard(1, "cam1", beat("power-saving", session=2), 3 * S)  # restarted
    assert rests.wakes[1].wakes == 0


def test_program_that_is_started_again_late_is_no_late_wake() -> None:
    rests = told()
    rests.heard(1, "cam1", beat("asleep"), 2 * S)
    rests.heard(1, "cam1", beat("power-saving", session=2), DUE_NS + 9 * S)
    assert rests.wakes[1].wakes == 0 and rests.said() == []
    assert rests.words(1, state("power-saving", DUE_NS + 9 * S), DUE_NS + 9 * S) == ""


def test_who_cannot_sleep_is_never_told_to() -> None:
    rests = Rests([0.5, 0.5])
    can = np.array([True, False])
    until = rests.order(TIMES, np.array([100, 100]), 20, LEAD, can)
    assert until.tolist() == [100, 0]
    assert rests.order(TIMES, np.array([100, 100]), 100, LEAD, CAN).tolist() == [0, 0]


def test_sleep_that_never_began_is_forgotten_once_it_is_over() -> None:
    rests = told()
    rests.heard(1, "cam1", beat("active"), 3 * S)
    rests.heard(1, "cam1", beat("active"), DUE_NS + S)
    assert rests.wakes[1].wakes == 0
    assert rests.words(1, state("active", DUE_NS + S), DUE_NS + 60 * S) == ""  # silent, not asleep


def test_camera_that_was_away_for_other_reasons_is_told_and_no_slow_one() -> None:
    rests = told()
    rests.heard(1, "cam1", beat("asleep"), 2 * S)
    rests.heard(1, "cam1", beat("power-saving"), DUE_NS + 600 * S)
    assert len(rests.said()) == 1 and rests.wakes[1].wakes == 0


def test_edge_that_was_away_itself_learns_nothing_of_a_wake() -> None:
    rests = told()
    rests.heard(1, "cam1", beat("asleep"), 2 * S)
    rests.excuse()
    asleep = state("asleep", 2 * S)
    assert rests.words(1, asleep, 4 * S).startswith("asleep")  # it may still sleep
    rests.heard(1, "cam1", beat("power-saving"), DUE_NS + 30 * S)
    assert rests.said() == [] and rests.wakes[1].wakes == 0
    assert rests.words(1, state("power-saving", DUE_NS + 30 * S), DUE_NS + 30 * S) == ""


def test_camera_that_once_woke_late_sleeps_again_some_time() -> None:
    """Woken so early that it never sleeps, it cannot show that it wakes sooner."""
    rests = told()
    rests.heard(1, "cam1", beat("asleep"), 2 * S)
    rests.heard(1, "cam1", beat("power-saving"), DUE_NS + 40 * S)
    assert rests.early_s(1) > 30.0
    for sleep in range(5):
        slot, until = 600 + 100 * sleep, 680 + 100 * sleep  # of eight seconds
        rests.order(TIMES, np.array([0, until]), slot, LEAD, CAN)
        rests.heard(1, "cam1", beat("active"), TIMES.begin_ns(until) + S)
    assert rests.early_s(1) < 8.0 and rests.wakes[1].mean_s > 0.5


def slept(rests: Rests, slot: int, wake_s: float, called: bool = False, session: int = 1) -> float:
    """Let camera 1 sleep for half a minute; return by how much it came late.

    Args:
        rests: of the site.
        slot: from which it sleeps.
        wake_s: from its alarm until it is heard.
        called: whether somebody calls it ten seconds after it fell asleep.
        session: of the program that is heard afterwards; 1 fell asleep.
    """
    rests.order(TIMES, np.array([0, slot + 300]), slot, LEAD, CAN)
    asleep_ns, due_ns = TIMES.begin_ns(slot) + S, TIMES.begin_ns(slot + 300 - LEAD)
    late_s = wake_s - rests.early_s(1)
    rests.heard(1, "cam1", beat("asleep"), asleep_ns)
    heard_ns = asleep_ns + 10 * S if called else due_ns + round(late_s * S)
    rests.heard(1, "cam1", beat("active", session), heard_ns)
    return late_s


def test_alarm_follows_what_a_camera_takes_to_wake_over_days() -> None:
    """Calls before the alarm and new programs teach nothing; what slows it down does."""
    rng, rests, slots = np.random.default_rng(5), Rests([0.5, 0.5]), count(0, 600)
    for mean_s in (4.0, 1.0, 6.0):  # as installed, a faster network, a hot summer
        late_s = []
        for number in range(600):
            late_s.append(slept(rests, next(slots), rng.normal(mean_s, 0.1 * mean_s)))
            slept(rests, next(slots), mean_s, called=True)
            if number % 5 == 0:
                slept(rests, next(slots), 25.0, session=2)
            if number >= 100:
                wake = rests.wakes[1]
                assert wake.mean_s == pytest.approx(mean_s, rel=0.15)
                assert wake.early_s < 2 * mean_s, "it is not awake for nothing"
        assert np.mean(np.array(late_s[100:]) > 0) < 0.1
    assert rests.wakes[1].wakes == 3 * 600


@each_case(
    ("online", "asleep_s", "paused", "sleeps"),
    [
        (False, 5.0, False, True),
        (False, -1.0, False, True),
        (False, -9.0, False, False),
        (False, None, False, False),
        (True, 5.0, False, False),
        (False, 5.0, True, False),
    ],
)
def test_status_tells_sleep_from_loss(
    online: bool, asleep_s: float | None, paused: bool, sleeps: bool
) -> None:
    camera = CameraStatus("cam1", online, asleep_s=asleep_s, paused=paused)
    assert sleeps_as_told(camera) == sleeps
