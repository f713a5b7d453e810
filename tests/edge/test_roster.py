"""Who can be chosen: every way in which a camera fails, and its way back."""

from __future__ import annotations

from msgspec import structs
from tests.cases import each_case

from e3pose.edge.roster import (
    FLOOD_RATE,
    FROZEN_S,
    QUARANTINE_S,
    RIVAL_S,
    SILENT_S,
    WRONG_LIMIT,
    CameraState,
    flooding,
    problem,
    with_heartbeat,
    with_hello,
    with_invalid_message,
    with_message,
    with_presence,
)
from e3pose.model.skeleton import BODY25, COCO17, COCO18, Skeleton
from e3pose.wire.messages import Heartbeat, Hello

JOINTS = ("nose", "hip")
SIZE = (640, 480)
SECOND = 10**9
NOW = 1000 * SECOND
HELLO = Hello("cam1", 5, JOINTS, SIZE, 25.0)
BEAT = Heartbeat("cam1", 5, NOW, "active", captured=10)


def well(at_ns: int = NOW) -> CameraState:
    return with_heartbeat(with_hello(CameraState("cam1"), HELLO, at_ns), BEAT, at_ns)


def why(camera: CameraState, at_ns: int = NOW) -> str:
    return problem(camera, JOINTS, SIZE, at_ns)


def test_camera_that_is_well_can_be_chosen() -> None:
    assert why(well()) == ""


@each_case(
    ("camera", "message"),
    [
        (CameraState("cam1"), "never connected"),
        (with_presence(well(), False, NOW), "not connected"),
        (with_message(CameraState("cam1"), NOW), "connecting"),
        (with_hello(CameraState("cam1"), HELLO, NOW), "connected, waiting for its first status"),
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
        (RIVAL_S / 2, message),
        (RIVAL_S, ""),
    ):  # one of them ended
        later_ns = at_ns + round(later_s * SECOND)
        camera = speak(camera, 9, later_ns)
        assert expected in why(camera, later_ns) and bool(expected) == bool(why(camera, later_ns))


def test_restarts_are_no_second_program() -> None:
    camera, at_ns = well(), NOW
    for session in range(6, 30):  # again and again, as of a program that crashes
        for _ in range(2):
            at_ns += SECOND // 4
            camera = speak(camera, session, at_ns)
            assert why(camera, at_ns) == ""
        assert len(camera.sessions) <= 4 and not camera.returns


def test_last_word_of_a_program_that_ended_may_come_late() -> None:
    camera = speak(speak(speak(well(), 9, NOW), 5, NOW), 9, NOW)
    assert why(camera) == ""


def test_silence_is_noticed_within_two_seconds() -> None:
    assert why(well(), NOW + round(SILENT_S * SECOND) - 1) == ""
    assert SILENT_S < 2 and "silent for" in why(well(), NOW + round(SILENT_S * SECOND) + 1)


def test_word_from_a_silent_camera_brings_it_back() -> None:
    later = NOW + 60 * SECOND
    assert why(with_heartbeat(well(), replace_beat(captured=99), later), later) == ""


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


@each_case("found", [COCO17, COCO18, BODY25])
@each_case("expected", [COCO17, COCO18, BODY25])
def test_camera_with_another_skeleton_of_the_body_serves(
    found: Skeleton, expected: Skeleton
) -> None:
    camera = with_hello(CameraState("cam1"), Hello("cam1", 5, found.joints, SIZE, 25.0), NOW)
    assert problem(with_heartbeat(camera, BEAT, NOW), expected.joints, SIZE, NOW) == ""


def replace_beat(**changes: object) -> Heartbeat:
    fields = {name: getattr(BEAT, name) for name in BEAT.__struct_fields__}
    return Heartbeat(**{**fields, **changes})


@each_case(
    ("beat", "message"),
    [
        (replace_beat(problem="no frames from the source"), "no frames from the source"),
        (replace_beat(battery_j=0.0, gauge=True), "battery empty"),
        (replace_beat(clock_error_ns=300_000_000), "clock uncertain by 300 ms"),
    ],
)
def test_ailing_camera_says_what_ails_it(beat: Heartbeat, message: str) -> None:
    assert why(with_heartbeat(well(), beat, NOW)) == message


def test_camera_without_a_frame_says_why() -> None:
    camera = with_heartbeat(CameraState("cam1"), replace_beat(problem="found no /dev/video7"), NOW)
    assert why(camera) == "found no /dev/video7"


def test_frozen_camera_is_noticed_though_it_speaks() -> None:
    camera = well()
    for second in range(1, 9):
        camera = with_heartbeat(camera, BEAT, NOW + second * SECOND)
        frozen = second > FROZEN_S
        assert why(camera, NOW + second * SECOND) == ("no new frames" if frozen else "")
    asleep = well()
    for second in range(1, 9):
        asleep = with_heartbeat(
            asleep, replace_beat(mode="aggressive-power-saving"), NOW + second * SECOND
        )
    assert why(asleep, NOW + 8 * SECOND) == ""


def test_nonsense_leads_to_quarantine_and_out_again() -> None:
    camera = well()
    for _ in range(WRONG_LIMIT - 1):
        camera = with_invalid_message(camera, "found 18 joints", NOW)
    assert why(camera) == ""
    camera = with_invalid_message(camera, "found 18 joints", NOW)
    assert why(camera) == "sends invalid messages (found 18 joints)"
    later = NOW + round(QUARANTINE_S * SECOND)
    assert why(with_heartbeat(camera, replace_beat(captured=11), later), later) == ""


def test_rare_nonsense_is_forgiven() -> None:
    camera = well()
    for second in range(200):
        camera = with_invalid_message(camera, "", NOW + second * SECOND)
    assert camera.quarantined_until_ns == 0


def test_flood_is_noticed_and_ends_with_its_second() -> None:
    camera = well()
    limit = round(FLOOD_RATE * (25 + 10))
    for _ in range(limit):
        camera = with_message(camera, NOW)
    assert not flooding(camera, 25)
    camera = with_message(camera, NOW)
    assert flooding(camera, 25)
    assert not flooding(with_message(camera, NOW + SECOND), 25)


def test_restarted_program_is_counted_and_begins_anew() -> None:
    again = with_hello(well(), Hello("cam1", 6, JOINTS, SIZE, 25.0), NOW)
    assert again.restarts == 1 and why(again) == "connected, waiting for its first status"
    assert with_hello(well(), HELLO, NOW).restarts == 0
