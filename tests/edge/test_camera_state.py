"""Which cameras count: every way in which one fails, sleeps or oversleeps, and its way back."""

from __future__ import annotations

from itertools import count
from typing import Any

import numpy as np
import pytest
from msgspec import structs
from tests.cases import each_case

from e3pose.edge import camera_state as cameras
from e3pose.edge.camera_state import CameraState, State, with_heartbeat, with_hello, with_message
from e3pose.edge.housekeeping import lasting_problem
from e3pose.model.skeleton import BODY25, COCO17, COCO18, Skeleton
from e3pose.wire.messages import Activity, Heartbeat, Hello
from e3pose.wire.site_messages import CameraStatus

JOINTS = ("nose", "hip")
SIZE = (640, 480)
SECOND = 10**9
NOW = 1000 * SECOND
HELLO = Hello("cam1", 5, JOINTS, SIZE, 25.0)
BEAT = Heartbeat("cam1", 5, NOW, "active", captured=10)


def well(at_ns: int = NOW) -> CameraState:
    return with_heartbeat(with_hello(CameraState("cam1"), HELLO, at_ns), BEAT, at_ns)


def why(camera: CameraState, at_ns: int = NOW) -> str:
    return cameras.standing(camera, JOINTS, SIZE, at_ns)[1]


@each_case(
    ("camera", "message"),
    [
        (CameraState("cam1"), "never connected"),
        (cameras.with_presence(well(), False, NOW), "not connected"),
        (with_message(CameraState("cam1"), NOW), "connecting"),
        (with_hello(CameraState("cam1"), HELLO, NOW), "connected, waiting for its first status"),
        (with_heartbeat(CameraState("cam1"), structs.replace(BEAT, problem="no frame"), NOW), "no"),
    ],
)
def test_incomplete_camera_says_what_is_missing(camera: CameraState, message: str) -> None:
    assert message in why(camera)


def test_camera_says_that_its_orders_come_late_until_they_do_not() -> None:
    camera = well()
    for late_orders, expected in ((0, False), (2, True), (2, False), (3, True), (0, False)):
        camera = with_heartbeat(camera, structs.replace(BEAT, late_orders=late_orders), NOW)
        assert camera.orders_late is expected


def speak(camera: CameraState, session: int, at_ns: int) -> CameraState:
    camera = with_hello(camera, structs.replace(HELLO, session=session), at_ns)
    return with_heartbeat(camera, structs.replace(BEAT, session=session, captured=at_ns), at_ns)


def test_two_programs_that_speak_as_one_camera_are_distinguished() -> None:
    camera, at_ns = well(), NOW
    for _ in range(4):
        for session in (5, 9):
            at_ns += SECOND // 4
            camera = speak(camera, session, at_ns)
    message = "two programs run as cam1 (sessions 5 and 9): stop one of them"
    assert message in why(camera, at_ns)
    for later_s, expected in (
        (1, message),
        (9.4, message),
        (10, ""),
    ):  # one of them ended
        later_ns = at_ns + round(later_s * SECOND)
        camera = speak(camera, 9, later_ns)
        assert expected in why(camera, later_ns) and bool(expected) == bool(why(camera, later_ns))


def test_restarts_are_no_second_program_and_begin_anew() -> None:
    camera, at_ns = well(), NOW
    for session in range(6, 30):  # again and again, as of a program that crashes
        for _ in range(2):
            at_ns += SECOND // 4
            camera = speak(camera, session, at_ns)
            assert why(camera, at_ns) == ""
        assert len(camera.sessions) <= 4 and not camera.returns
    late = speak(speak(speak(well(), 9, NOW), 5, NOW), 9, NOW)
    assert why(late) == ""  # the last word of a program that ended may come late
    again = with_hello(well(), Hello("cam1", 6, JOINTS, SIZE, 25.0), NOW)
    assert again.restarts == 1 and why(again) == "connected, waiting for its first status"
    assert with_hello(well(), HELLO, NOW).restarts == 0


def test_silence_is_noticed_within_two_seconds() -> None:
    assert why(well(), NOW + 1_900_000_000) == ""
    assert "silent for" in why(well(), NOW + 1_900_000_001)


@each_case(
    ("hello", "message"),
    [
        (
            Hello("cam1", 5, COCO18.joints, SIZE, 25.0),
            "detector outputs coco18 without hip, the site expects 2 joints",
        ),
        (
            Hello("cam1", 5, ("nose",), SIZE, 25.0),
            "outputs 1 joint without hip, the site expects 2 joints",
        ),
        (Hello("cam1", 5, JOINTS, (640, 481), 25.0), "640 x 481, but the calibration has 640 x"),
    ],
)
def test_camera_of_another_rig_is_refused(hello: Hello, message: str) -> None:
    assert message in why(with_heartbeat(with_hello(CameraState("cam1"), hello, NOW), BEAT, NOW))


def test_joints_of_an_unknown_detector_are_not_lost_without_a_word() -> None:
    hello = Hello("cam1", 5, BODY25.joints, SIZE, 25.0)
    camera = with_heartbeat(with_hello(CameraState("cam1"), hello, NOW), BEAT, NOW)
    for known, message in (
        (None, ""),
        ([BODY25.joints], ""),
        ([COCO17.joints], "6 of 25 joints not used: left_big_toe, left_small_toe, left_heel"),
    ):
        assert message in cameras.standing(camera, COCO17.joints, SIZE, NOW, known)[1]
        assert bool(message) == bool(cameras.standing(camera, COCO17.joints, SIZE, NOW, known)[1])


@each_case("found", [COCO17, COCO18, BODY25])
@each_case("expected", [COCO17, COCO18, BODY25])
def test_camera_with_another_skeleton_of_the_body_serves(
    found: Skeleton, expected: Skeleton
) -> None:
    camera = with_hello(CameraState("cam1"), Hello("cam1", 5, found.joints, SIZE, 25.0), NOW)
    assert cameras.standing(with_heartbeat(camera, BEAT, NOW), expected.joints, SIZE, NOW)[1] == ""


@each_case(
    ("beat", "message"),
    [
        (BEAT, ""),
        (structs.replace(BEAT, problem="no frames from the source"), "no frames from the source"),
        (structs.replace(BEAT, battery_j=0.0, gauge=True), "battery empty"),
        (structs.replace(BEAT, battery_j=0.0), "battery empty (modelled)"),
        (structs.replace(BEAT, clock_error_ns=300_000_000), "clock uncertain by 300 ms"),
    ],
)
def test_ailing_camera_says_what_ails_it(beat: Heartbeat, message: str) -> None:
    assert why(with_heartbeat(well(), beat, NOW)) == message


def test_frozen_camera_is_noticed_though_it_speaks() -> None:
    camera = well()
    for second in range(1, 9):
        camera = with_heartbeat(camera, BEAT, NOW + second * SECOND)
        frozen = second > 5
        assert why(camera, NOW + second * SECOND) == ("no new frames" if frozen else "")
    asleep = well()
    for second in range(1, 9):
        asleep = with_heartbeat(
            asleep, structs.replace(BEAT, mode="aggressive-power-saving"), NOW + second * SECOND
        )
    assert why(asleep, NOW + 8 * SECOND) == ""


def test_nonsense_leads_to_quarantine_and_out_again() -> None:
    camera = well()
    for _ in range(19):
        camera = cameras.with_invalid_message(camera, "found 18 joints", NOW)
    assert why(camera) == ""
    camera = cameras.with_invalid_message(camera, "found 18 joints", NOW)
    assert why(camera) == "sends invalid messages (found 18 joints)"
    later = NOW + 5 * SECOND
    assert camera.quarantined_until_ns == later
    assert why(with_heartbeat(camera, structs.replace(BEAT, captured=11), later), later) == ""


def test_rare_nonsense_is_forgiven() -> None:
    for gap_s, quarantined in ((1.0, False), (0.53, False), (0.52, True)):  # twenty in ten seconds
        camera = well()
        for number in range(200):
            at_ns = NOW + round(number * gap_s * SECOND)
            camera = cameras.with_invalid_message(camera, "", at_ns)
        assert (camera.quarantined_until_ns > 0) is quarantined, gap_s


def test_flood_is_noticed_and_ends_with_its_second() -> None:
    camera = well()
    limit = 4 * (25 + 10)
    for _ in range(limit):
        camera = with_message(camera, NOW)
    assert not cameras.flooding(camera, 25, NOW)
    camera = with_message(camera, NOW)
    assert cameras.flooding(camera, 25, NOW + SECOND - 1) and not cameras.flooding(
        camera, 25, NOW + SECOND
    )
    assert not cameras.flooding(with_message(camera, NOW + SECOND), 25, NOW + SECOND)


@each_case("first", ["word", "connection"])
def test_order_of_the_last_word_and_the_lost_connection_is_no_matter(first: str) -> None:
    camera, last = well(), structs.replace(BEAT, ends=True)
    for step in (first, "connection" if first == "word" else "word"):
        if step == "word":
            camera = with_heartbeat(camera, last, NOW)
        else:
            camera = cameras.with_presence(camera, False, NOW)
    assert why(camera) == "stopped"
    assert why(speak(cameras.with_presence(camera, True, NOW), 8, NOW)) == ""


# Sleep by order.

S = SECOND
DUE_NS = 100 * S


def told(due_ns: int = DUE_NS, wake_s: float = 0.5) -> CameraState:
    """Return a camera that was told to sleep until a slot."""
    return cameras.with_order_to_sleep(CameraState.unheard("cam1", wake_s), due_ns // S, due_ns)


def heard(camera: CameraState, mode: Activity, at_ns: int, session: int = 1) -> CameraState:
    return with_heartbeat(camera, Heartbeat("cam1", session, 0, mode), at_ns)


def test_alarms_are_early_by_two_standard_deviations_and_a_minute_at_most() -> None:
    wake = cameras.WakeTime.stated(0.5)
    assert wake.early_s == pytest.approx(0.5 + 2 * 0.25)
    for _ in range(300):
        wake = wake.after(1e9)
    assert wake.early_s <= 60.0  # one that was away for a day is no slow one


def test_camera_asleep_is_expected_back_when_its_next_order_is_made() -> None:
    asleep = heard(told(), "asleep", 2 * S)
    assert why(asleep, DUE_NS - 6 * S) == "asleep for 6 s"
    assert why(asleep, DUE_NS + S) == "asleep for 0 s"  # it may still speak
    assert why(asleep, DUE_NS + 5 * S) == "overslept by 5 s"
    assert why(told(), 4 * S).startswith("asleep")  # though a new edge has never heard it
    assert why(heard(CameraState("cam1"), "asleep", 2 * S), 3 * S) == "connecting"  # nobody told it
    never = cameras.with_order_to_sleep(CameraState("cam0"), 0, 4 * S)
    assert why(never, 4 * S) == "never connected"
    awake = heard(with_hello(told(), HELLO, 4 * S), "active", 4 * S, 5)
    assert why(awake, 4 * S) == ""
    assert why(awake, 7 * S).startswith("asleep")  # its last word may be lost


def test_program_that_dies_in_its_sleep_is_dead_and_a_suspended_machine_is_not() -> None:
    assert (
        why(cameras.with_presence(heard(told(), "asleep", S), False, S), 4 * S) == "not connected"
    )
    away = cameras.with_presence(heard(told(), "suspended", S), False, S)
    assert why(away, 4 * S).startswith("asleep")
    ends = with_heartbeat(told(), Heartbeat("cam1", 1, 0, "asleep", ends=True), S)
    assert why(ends, 4 * S) == "stopped"


@each_case(
    ("modes", "back_s", "session", "late_s", "mean_s"),
    [
        (["suspended"], 3.0, 1, 3.0, 2.25),  # of 4 s, as its alarm was 1 s early
        (["asleep"], 1.1, 1, 1.1, 1.3),
        (["asleep"], 0.9, 1, 0.0, 1.2),  # too little to tell anybody
        (["asleep"], -0.5, 1, 0.0, 0.5),  # in time
        (["asleep"], -97.0, 2, 0.0, 0.5),  # its program was started again
        (["asleep"], 9.0, 2, 0.0, 0.5),
        (["active"], 1.0, 1, 0.0, 0.5),  # it never slept as far as is known
        (["asleep"], 600.0, 1, 600.0, 0.5),  # it was away for other reasons
        (["asleep", "excused"], 30.0, 1, 0.0, 0.5),  # the edge itself was away
    ],
)
def test_what_a_wake_teaches(
    modes: list[Any], back_s: float, session: int, late_s: float, mean_s: float
) -> None:
    camera = heard(told(), modes[0], 2 * S)
    if modes[1:]:
        camera = cameras.with_excused_wake(camera)
        assert why(camera, 4 * S).startswith("asleep")  # it may still sleep
    back_ns = DUE_NS + round(back_s * S)
    back = heard(camera, "power-saving", back_ns, session)
    assert back.overslept_s == pytest.approx(late_s) and back.wake.mean_s == pytest.approx(mean_s)
    assert why(back, back_ns + 60 * S) == "silent for 60 s"  # not asleep
    assert heard(back, "active", back_ns + S).overslept_s == 0.0  # told once
    longer = cameras.with_order_to_sleep(back, 200, 200 * S).early_s > told().early_s
    assert longer == (mean_s > 0.5), "the next alarm is earlier"


def test_camera_that_once_woke_late_sleeps_again_some_time() -> None:
    """Woken so early that it never sleeps, it cannot show that it wakes sooner."""
    camera = heard(heard(told(), "asleep", 2 * S), "power-saving", DUE_NS + 40 * S)
    assert cameras.with_order_to_sleep(camera, 1, 1).early_s > 30.0
    for sleep in range(5):
        due_ns = DUE_NS + (60 + 10 * sleep) * S
        camera = cameras.with_order_to_sleep(camera, due_ns // S, due_ns)
        camera = heard(camera, "active", due_ns + S)
    assert camera.early_s < 8.0 and camera.wake.mean_s > 0.5


def slept(
    camera: CameraState, from_s: int, wake_s: float, called: bool = False, session: int = 1
) -> tuple[CameraState, float]:
    """Let a camera sleep for half a minute; return it, and by how much it came late."""
    asleep_ns, due_ns = (from_s + 1) * S, (from_s + 30) * S
    camera = cameras.with_order_to_sleep(camera, from_s + 30, due_ns)
    late_s = wake_s - camera.early_s
    heard_ns = asleep_ns + 10 * S if called else due_ns + round(late_s * S)
    camera = heard(heard(camera, "asleep", asleep_ns), "active", heard_ns, session)
    return camera, late_s


def test_alarm_follows_what_a_camera_takes_to_wake_over_days() -> None:
    """Calls before the alarm and new programs teach nothing; what slows it down does."""
    rng, camera, begins = np.random.default_rng(5), CameraState.unheard("cam1", 0.5), count(0, 60)
    for mean_s in (4.0, 1.0, 6.0):  # as installed, a faster network, a hot summer
        late_s = []
        for number in range(600):
            camera, late = slept(camera, next(begins), rng.normal(mean_s, 0.1 * mean_s))
            late_s.append(late)
            camera, _ = slept(camera, next(begins), mean_s, called=True)
            if number % 5 == 0:
                camera, _ = slept(camera, next(begins), 25.0, session=2)
            if number >= 100:
                assert camera.wake.mean_s == pytest.approx(mean_s, rel=0.15)
                assert camera.wake.early_s < 2 * mean_s, "it is not awake for nothing"
        assert np.mean(np.array(late_s[100:]) > 0) < 0.1
    assert camera.wake.wakes == 3 * 600


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
    assert cameras.sleeps_as_told(camera) == sleeps


@each_case(
    ("state", "why", "was", "lasts"),
    [
        (State.ASLEEP, "asleep for 3 s", "", ""),
        (State.BARRED, "connecting", "", ""),  # woke while its edge was started again
        (State.BARRED, "connecting", "never connected", "never connected"),
        (State.LEFT, "not connected", "", "not connected"),
        (State.LEFT, "overslept by 5 s", "", "overslept by 5 s"),
        (State.READY, "", "not connected", ""),
    ],
)
def test_who_sleeps_or_connects_is_neither_lost_nor_back(
    state: State, why: str, was: str, lasts: str
) -> None:
    assert lasting_problem(state, why, was) == lasts
