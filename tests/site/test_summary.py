"""What programs say in the end, as a person would say it."""

from __future__ import annotations

import io
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from e3pose.camera.live import Counted
from e3pose.plural import counted
from e3pose.site.screen import screen
from e3pose.site.summary import camera_summary, edge_summary
from e3pose.wire.codec import MAX_FIGURE
from e3pose.wire.messages import CameraStatus, Status

NUMBERS = st.floats() | st.sampled_from(
    [0.0, -0.0, 1.0, -1.0, MAX_FIGURE, -MAX_FIGURE, math.inf, -math.inf, math.nan]
)


def test_one_is_one_and_large_numbers_are_whole() -> None:
    assert counted(1, "slot") == "1 slot"
    assert counted(0, "slot") == "0 slots"
    assert counted(1, "person", "people") == "1 person"
    assert counted(3, "person", "people") == "3 people"
    assert counted(1_234_567, "row") == "1234567 rows"
    assert counted(0.95, "camera") == "0.95 cameras"


def test_edge_says_how_it_left_each_camera() -> None:
    cameras = (
        CameraStatus("cam0", False, why="ended", last_seen_s=0.1, duty=0.5, late=1, lost=0),
        CameraStatus("cam1", True, last_seen_s=0.1, duty=0.25, late=2, lost=3),
        CameraStatus("cam2", True, why="views come late", last_seen_s=0.1),
        CameraStatus("cam3", False, why="never seen"),
    )
    status = Status("lab", 1, 20.0, 2, 1, cameras, (1.0, 2.0), (3.0, 4.0))
    assert edge_summary(status, 1, 1) == [
        "1 slot, 0 lost, 1 view in time; lead 2; a slot takes 1.0 ms (99 %: 2.0), "
        "poses come 3.0 ms (99 %: 4.0) after the last view",
        "  cam0: ended; looked in 50% of the last minute's slots, 1 view late, 0 lost",
        "  cam1: online; looked in 25% of the last minute's slots, 2 views late, 3 lost",
        "  cam2: online, views come late; looked in 0% of the last minute's slots, "
        "0 views late, 0 lost",
        "  cam3: never seen",
    ]


def test_edge_that_did_nothing_says_why_and_measures_nothing() -> None:
    status = Status("lab", 0, 0.0, 2, 0, (CameraStatus("cam0", False, why="never seen"),))
    told = edge_summary(status, 0, 0)
    assert told == ["no slots: fewer than two cameras were there", "  cam0: never seen"]


def test_the_screen_tells_of_a_shifted_camera_unless_something_is_worse() -> None:
    cameras = (
        CameraStatus("cam0", True, last_seen_s=0.1, shift_px=2.0),
        CameraStatus("cam1", True, last_seen_s=0.1, shift_px=6.2),
        CameraStatus("cam2", True, why="views come late", last_seen_s=0.1, shift_px=9.0),
        CameraStatus("cam3", True, last_seen_s=0.1, shift_px=math.nan),
    )
    out = io.StringIO()
    Console(file=out, width=120).print(screen(Status("lab", 1, 20.0, 2, 1, cameras), 0.1))
    told = out.getvalue()
    assert told.count("px off") == 1
    assert "6 px off" in told
    assert "views come late" in told


def test_camera_without_frames_says_why() -> None:
    assert camera_summary("cam0", Counted(), 0, 0) == "cam0: no frames"
    told = camera_summary("cam0", Counted(), 0, 0, "source usb:0: found no /dev/video0")
    assert told == "cam0: no frames: source usb:0: found no /dev/video0"


@pytest.mark.parametrize(
    ("done", "orders", "late", "told"),
    [
        (Counted(1, 1, 1), 4, 1, "cam0: 1 frame, 1 looked at, 1 view sent, 1 late order"),
        (Counted(9, 2, 2), 4, 0, "cam0: 9 frames, 2 looked at, 2 views sent, 0 late orders"),
        (Counted(9), 0, 0, "cam0: 9 frames, but no orders: no edge asked it"),
    ],
)
def test_camera_says_what_it_did(done: Counted, orders: int, late: int, told: str) -> None:
    assert camera_summary("cam0", done, orders, late) == told


def test_screen_marks_what_a_model_says() -> None:
    from io import StringIO

    from rich.console import Console

    told = []
    for gauge in (True, False):
        camera = CameraStatus("cam0", True, mode="active", battery=0.625, gauge=gauge)
        out = StringIO()
        console = Console(file=out, width=120)
        console.print(screen(Status("lab", 1, 20.0, 1, 1, (camera,)), 0.0))
        told.append(out.getvalue())
        assert "1 person" in out.getvalue() and "1/1 camera" in out.getvalue()
    assert " 62%" in told[0] and "~" not in told[0]
    assert "~62%" in told[1]


def test_screen_before_the_first_slot_measures_nothing() -> None:
    from io import StringIO

    from rich.console import Console

    out = StringIO()
    status = Status("lab", 0, 0.0, 5, 0, (CameraStatus("cam0", False, why="never seen"),))
    Console(file=out, width=120).print(screen(status, 0.0))
    assert "no slots yet" in out.getvalue() and "step" not in out.getvalue()


def test_check_says_what_to_do_about_a_battery_that_a_model_emptied() -> None:
    from e3pose.site.check import check_running

    for gauge, told in ((False, "delete the file"), (True, "see its log")):
        camera = CameraStatus("cam0", False, why="battery empty", battery=0.0, gauge=gauge)
        found = list(check_running(Status("lab", 1, 20.0, 1, 0, (camera,)), "tcp/127.0.0.1:7447"))
        assert found[-1].level == "problem" and told in found[-1].advice


@settings(max_examples=300, deadline=None)
@given(*[NUMBERS] * 10)
def test_screen_draws_whatever_numbers_a_status_has(
    battery: float, duty: float, seen_s: float, power_w: float, deficit: float, offset_ms: float,
    uptime_s: float, fps: float, error_mm: float, step_ms: float,
) -> None:  # fmt: skip
    camera = CameraStatus(
        "cam0", True, "", "active", seen_s, duty, power_w, True, battery, deficit,
        clock_offset_ms=offset_ms,
    )  # fmt: skip
    status = Status(
        "lab", 1, fps, 1, 2, (camera,), (step_ms, step_ms), (step_ms, step_ms), uptime_s,
        expected_error_mm=error_mm,
    )  # fmt: skip
    console = Console(file=io.StringIO(), width=120)
    console.print(screen(status, 0.0))


def test_screen_draws_a_battery_and_a_time_within_their_ends() -> None:
    def drawn(battery: float, uptime_s: float) -> str:
        camera = CameraStatus("cam0", True, last_seen_s=0.1, battery=battery, gauge=True)
        console = Console(file=io.StringIO(), width=120)
        console.print(screen(Status("lab", 1, 0.0, 1, 0, (camera,), uptime_s=uptime_s), 0.0))
        assert isinstance(console.file, io.StringIO)
        return console.file.getvalue()

    assert "||||||||||  100%" in drawn(math.inf, 61.0) and "up 0:01:01" in drawn(0.5, 61.0)
    assert "..........    0%" in drawn(-math.inf, math.nan) and "up 0:00:00" in drawn(0, -math.inf)
