"""What `e3pose top` draws of a status."""

from __future__ import annotations

import io
import math
import re
from pathlib import Path

import msgspec
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from tests.cases import each_case

import e3pose
from e3pose.site.screen import EVENTS, MODES, screen
from e3pose.wire.bounds import MAX_FIGURE
from e3pose.wire.site_messages import CameraStatus, Status

NUMBERS = st.floats() | st.sampled_from(
    [0.0, -0.0, 1.0, -1.0, MAX_FIGURE, -MAX_FIGURE, math.inf, -math.inf, math.nan]
)


def drawn(status: Status | None, stale_s: float = 0.0) -> str:
    """Return the text of the screen, without colours."""
    out = io.StringIO()
    Console(file=out, width=120).print(screen(status, stale_s))
    return out.getvalue()


def row(camera: CameraStatus) -> list[str]:
    """Return the cells of a camera, as they are drawn."""
    lines = drawn(Status("lab", 1, 20.0, 1, 1, (camera,))).splitlines()
    return next(line.split() for line in lines if line.startswith(f"{camera.camera_id} "))


def test_before_the_first_slot_it_waits_and_measures_nothing() -> None:
    assert "Waiting for the edge" in drawn(None)
    # Screen before the first slot measures nothing.
    text = drawn(Status("lab", 0, 0.0, 5, 0, (CameraStatus("cam0", False, why="never seen"),)))
    assert "no slots yet" in text and "computing" not in text
    compiling = Status("lab", 0, 0.0, 5, 0, (), compiling_s=12.0)
    assert "compiling: 12 s left (first start only)" in drawn(compiling)


def test_head_sums_up_what_the_edge_measured() -> None:
    cameras = (
        CameraStatus("cam0", True, power_w=4.25, measured=True),
        CameraStatus("cam1", True, power_w=3.0),
        CameraStatus("cam2", False, power_w=9.0),  # what it drew when it was there
        CameraStatus("cam3", True),
    )
    text = drawn(
        Status(
            "lab", 417, 19.96, 3, 2, cameras, (1.25, 2.5), (3.75, 5.0), 3661.0,
            expected_error_mm=23.4, slots_lost=5,
        )
    )  # fmt: skip
    for said in (
        "lab", "3/4 cameras", "2 people, expected error 23 mm", "slot 417", "20.0/s", "lead 3",
        "1:01:01", "1.2 ms (99 %: 2.5)", "3.8 ms (99 %: 5.0)", "5 slots lost", "7.2 W",
    ):  # fmt: skip
        assert said in text, said
    assert "no update" not in text


def test_head_states_both_savings() -> None:
    cameras = (CameraStatus("cam0", True, cpu_s=6.0, cpu_saved=0.25), CameraStatus("cam1", True))
    status = Status("lab", 1, 20.0, 1, 1, cameras, spent_j=60.0, always_j=80.0)
    said = "Saved, compared with all cameras active in every slot: whole camera 25 % (modelled), "
    assert said in drawn(status) and "processor time 25 % (measured)" in drawn(status)
    metered = msgspec.structs.replace(status, energy_measured=True)
    assert "whole camera 25 % (measured)" in drawn(metered)
    assert "Saved" not in drawn(Status("lab", 1, 20.0, 1, 1, ()))


def test_head_tells_of_blind_slots_overload_and_its_own_age() -> None:
    status = Status("lab", 417, 20.0, 3, 2, (), slots=400, blind_share=0.031)
    assert "blind" not in drawn(status)
    blind = msgspec.structs.replace(status, blind={"orders-late": 8, "views-missing": 4})
    assert "12 slots blind, 3% of the last minute: 8 orders late, 4 views missing" in drawn(blind)
    # Overload is told in the head.
    said = "edge overloaded, computing takes 130% of a slot: cameras are selected by round robin"
    assert said in drawn(Status("lab", 417, 20.0, 3, 2, (), overload=said))
    # Status that is old says so.
    status = Status("lab", 1, 20.0, 1, 1, ())
    assert "no update for 12 s" in drawn(status, 12.2)
    assert "no update" not in drawn(status, 2.9)


def test_share_of_views_that_a_camera_delivers_is_shown_once_it_is_known() -> None:
    short = CameraStatus("cam0", True, why="its source brings 12.5", delivered=0.51, lost=4)
    assert "51%" in row(short)
    titled = msgspec.structs.replace(short, title="Küche")
    shown = drawn(Status("lab", 1, 20.0, 3, 2, (titled,)))
    assert shown.count("Küche") == 2 and "cam0" not in shown  # its row, and what is wrong
    assert [cell for cell in row(CameraStatus("cam0", True)) if "%" in cell] == ["0%"]  # duty


def test_head_says_whether_the_target_error_is_kept() -> None:
    busy = (CameraStatus("cam0", True, mode="active"), CameraStatus("cam1", False))
    free = (*busy, CameraStatus("cam2", True, mode="power-saving"))

    def head(cameras: tuple[CameraStatus, ...], expected_mm: float) -> str:
        status = Status("lab", 1, 20.0, 1, 2, cameras, expected_error_mm=expected_mm)
        return drawn(msgspec.structs.replace(status, target_error_mm=40.0)).splitlines()[0]

    assert head(busy, 43.0).endswith("2 people, expected error 43 mm (target 40 mm)")
    assert head(busy, 52.0).endswith("52 mm (target 40 mm), no camera left to wake")
    assert head(free, 52.0).endswith("52 mm (target 40 mm)")


def test_row_of_a_camera_that_is_there_and_of_one_that_is_not() -> None:
    here = CameraStatus(
        "cam0", True, "views come late", "power-saving", last_seen_s=0.25, duty=0.5, power_w=4.25,
        measured=True, deficit=1.5, late=3, lost=4, clock_offset_ms=-2.5, noise_factor=1.25,
    )  # fmt: skip
    cells = ["cam0", "idle", "50%", "4.2", "1.5", "0.2", "s", "3", "4", "-2.5", "1.2x"]
    assert row(here) == cells
    assert "cam0: views come late" in drawn(Status("lab", 1, 20.0, 1, 1, (here,)))
    never = CameraStatus("cam1", False, "never seen", power_w=4.0)
    assert row(never) == ["cam1", "offline", "0%", "0.0", "never", "0", "0"]


def test_what_a_model_says_is_marked() -> None:
    assert "~4.2" in row(CameraStatus("cam0", True, power_w=4.25))
    assert "4.2" in row(CameraStatus("cam0", True, power_w=4.25, measured=True))
    # Screen marks what a model says.
    shown = []
    for gauge in (True, False):
        camera = CameraStatus("cam0", True, mode="active", battery=0.625, gauge=gauge)
        shown.append(drawn(Status("lab", 1, 20.0, 1, 1, (camera,))))
        assert "1 person" in shown[-1] and "1/1 camera" in shown[-1]
    assert " 62%" in shown[0] and "~" not in shown[0]
    assert "~62%" in shown[1]


def test_newest_events_are_shown_and_older_ones_are_not() -> None:
    events = tuple(f"event {number:02}" for number in range(EVENTS + 3))
    text = drawn(Status("lab", 1, 20.0, 1, 1, (), events=events))
    assert [line for line in text.splitlines() if line.startswith("event ")] == [*events[3:]]


def test_screen_tells_of_a_camera_that_was_knocked_and_what_mends_it() -> None:
    camera = CameraStatus("cam2", True, last_seen_s=0.1, turned_deg=1.44)
    shown = drawn(Status("lab", 1, 20.0, 2, 1, (camera,)), 0.1)
    assert "cam2: has moved: turned by 1.4 degrees or more" in shown
    assert "e3pose calibrate extrinsics SITE --only cam2" in shown


@each_case("width", [60, 80, 140])
def test_screen_fits_the_terminal(width: int) -> None:
    camera = CameraStatus(
        "cam0", True, mode="power-saving", last_seen_s=0.2, duty=0.4, power_w=6.25,
        battery=0.6, deficit=1.5, late=12, lost=3, clock_offset_ms=-3.2, noise_factor=1.4,
        delivered=0.97,
    )  # fmt: skip
    away = CameraStatus("cam1", False, why="silent for 5 s", last_seen_s=5.0)
    out = io.StringIO()
    status = Status("lab", 1, 20.0, 4, 3, (camera, away), expected_error_mm=27.2)
    Console(file=out, width=width).print(screen(status, 0.0))
    lines = out.getvalue().splitlines()
    assert all(len(line) <= width for line in lines) and not any("\u2026" in line for line in lines)
    assert "3 people, expected error 27 mm" in out.getvalue()
    assert "cam1: silent for 5 s" in lines
    shown = next(line for line in lines if line.startswith("cam0"))
    assert "40%" in shown and "60%" in shown and "12" in shown
    assert "97%" in shown
    assert ("1.4x" in shown) == (width >= 80)


@settings(max_examples=100)
@given(*[NUMBERS] * 10)
def test_screen_draws_whatever_numbers_a_status_has(
    battery: float, duty: float, seen_s: float, power_w: float, deficit: float, offset_ms: float,
    uptime_s: float, fps: float, error_mm: float, step_ms: float,
) -> None:  # fmt: skip
    camera = CameraStatus(
        "cam0", True, mode="active", last_seen_s=seen_s, duty=duty, power_w=power_w, measured=True,
        battery=battery, deficit=deficit, clock_offset_ms=offset_ms,
    )  # fmt: skip
    status = Status(
        "lab", 1, fps, 1, 2, (camera,), (step_ms, step_ms), (step_ms, step_ms), uptime_s,
        expected_error_mm=error_mm,
    )  # fmt: skip
    assert drawn(status)


def test_screen_draws_a_battery_and_a_time_within_their_ends() -> None:
    def said(battery: float, uptime_s: float) -> str:
        camera = CameraStatus("cam0", True, last_seen_s=0.1, battery=battery, gauge=True)
        return drawn(Status("lab", 1, 0.0, 1, 0, (camera,), uptime_s=uptime_s))

    assert "||||||||||  100%" in said(math.inf, 61.0) and "up 0:01:01" in said(0.5, 61.0)
    assert "..........    0%" in said(-math.inf, math.nan) and "up 0:00:00" in said(0, -math.inf)


def test_pages_and_terminals_have_one_word_for_what_a_camera_does() -> None:
    pages = Path(e3pose.__file__).parent
    banned = re.compile(
        r"\b(looking|resting|sleeping)\b|\"(saving|gone|moment)\"|`track \$|cameras looked"
    )
    for path in [*pages.glob("site/web/browser/*.js"), *pages.glob("output/report/*.js")]:
        said = [line for line in path.read_text().splitlines() if not line.startswith("//")]
        assert not [line for line in said if banned.search(line)], path
    words = {word for word, _ in MODES.values()}
    details = (pages / "site/web/browser/details.js").read_text()
    assert words >= {
        *re.findall(r'": "(\w+)"', details.partition("MODES = {")[2].partition("}")[0])
    }
