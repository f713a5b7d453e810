"""Tables of what cameras can do, awake and asleep, and the plan of boards."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case
from tests.cli.commands import run

from e3pose.base.errors import InputError
from e3pose.energy.modes import RESTS, Rest
from e3pose.energy.plan import SENSOR_ERROR, Board, Figure, hours_text, load_boards, plan, reaches
from e3pose.energy.profiles import PROFILES, load_profile, modes_of, profile_text
from e3pose.energy.rest_costs import rest_costs

BASE = """
format = "e3pose-power-profile"
version = {version}
name = "board"
title = "a board"

[components.all]
group = "cpu_gpu"
active = {{ watts = 8.0, source = "meter" }}
power-saving = {{ watts = 4.0, source = "meter" }}
aggressive-power-saving = {{ watts = 3.0, source = "meter" }}
"""
SUSPENDED = """
[rests.suspended]
watts = 0.4
enter_s = 1.5
wake_s = 2.5
wake_sd_s = 0.25
source = "wall plug, 2026-05-02"
"""
TRACKED = """
[looks.tracked]
joules = 0.03
latency_s = 0.006
source = "tegrastats, 1000 looks"
"""


def profile(folder: Path, rows: str = "", version: int = 2) -> Path:
    file = folder / "board.toml"
    file.write_text(BASE.format(version=version) + rows)
    return file


def test_a_profile_without_rows_has_only_what_its_components_say(tmp_path: Path) -> None:
    for version in (1, 2):
        modes = modes_of(load_profile(profile(tmp_path, version=version)), interval_s=0.08)
        assert [look.name for look in modes.looks] == ["whole", "nothing"]
        assert [rest.name for rest in modes.rests] == ["idle", "not-capturing"]
        whole, idle = modes.look("whole"), modes.rest("idle")
        assert whole is not None and whole.joules == pytest.approx((8 - 4) * 0.08)
        assert whole.source == "active less power-saving, 80 ms"
        assert idle is not None and (idle.watts, idle.wake_s) == (4.0, 0.0)
        assert modes.rest("suspended") is None and modes.look("tracked") is None


def test_rows_of_a_profile_are_in_the_table_with_their_sources(tmp_path: Path) -> None:
    modes = modes_of(load_profile(profile(tmp_path, SUSPENDED + TRACKED)))
    suspended, tracked = modes.rest("suspended"), modes.look("tracked")
    assert suspended is not None and tracked is not None
    assert (suspended.watts, suspended.enter_s) == (0.4, 1.5)
    assert (suspended.wake_s, suspended.wake_sd_s) == (2.5, 0.25)
    assert (tracked.joules, tracked.latency_s) == (0.03, 0.006)
    assert "wall plug" in suspended.source and "tegrastats" in tracked.source
    assert modes.table == "profile board"
    written = tmp_path / "written.toml"
    written.write_text(profile_text(load_profile(profile(tmp_path, SUSPENDED + TRACKED))))
    assert modes_of(load_profile(written)) == modes


@each_case("name", PROFILES)
def test_a_shipped_profile_rests_no_louder_the_deeper_it_rests(name: str) -> None:
    modes = modes_of(load_profile(name))
    watts = [round(rest.watts, 6) for rest in modes.rests]
    assert watts == sorted(watts, reverse=True)
    assert [r.name for r in modes.rests] == [n for n in RESTS if modes.rest(n) is not None]
    # Nobody measured a suspended board for us, and none of these states a figure without one.
    assert modes.rest("asleep") is not None and modes.rest("suspended") is None


@each_case(
    ("rows", "message"),
    [
        (SUSPENDED.replace("0.4", "5.0"), r"rests\[suspended\]\.watts: found 5 W, .* at most 3 W"),
        (SUSPENDED.replace("0.4", "nan"), r"rests\[suspended\]\.watts: found nan"),
        (SUSPENDED.replace("1.5", "-1"), r"rests\[suspended\]\.enter_s: found -1"),
        (SUSPENDED.replace("2.5", "true"), r"rests\[suspended\]\.wake_s: found a boolean"),
        (
            SUSPENDED.replace("suspended", "dozing"),
            r"rests\[dozing\]: .* 'idle' or 'not-capturing'",
        ),
        (SUSPENDED.replace("enter_s", "enter"), r"rests\[suspended\]: .* key 'enter', .*enter_s"),
        (TRACKED.replace("tracked", "nothing"), r"looks\[nothing\]: found 'nothing', .*'gate'"),
        (TRACKED + "colour = 1\n", r"looks\[tracked\]: found unknown key 'colour'"),
        ("[looks]\ntracked = 3\n", r"looks\[tracked\]: found a whole number, expected a table"),
    ],
)
def test_wrong_rows_are_refused_by_name(tmp_path: Path, rows: str, message: str) -> None:
    with pytest.raises(InputError, match=rf"board\.toml: {message}"):
        load_profile(profile(tmp_path, rows))


def test_a_file_of_version_1_has_no_rows(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="version: found 1, expected 2 where"):
        load_profile(profile(tmp_path, SUSPENDED, version=1))


COSTS = rest_costs([12.0, 12.0], [6.0, 6.0], [Rest("suspended", 0.5, 0.4, 1.0, 0.2), None])


def test_alarms_go_off_early_and_a_short_rest_saves_nothing_and_a_long_one_nearly_all() -> None:
    assert COSTS.rests.tolist() == [True, False]
    assert COSTS.drawn_w(np.zeros(2, bool), np.ones(2, bool)).tolist() == [0.5, 6.0]
    np.testing.assert_allclose(COSTS.alarm_s, [1.4, 0.0])
    np.testing.assert_allclose(COSTS.lost_s, [1.8, 0.0])
    for rest_s in (0.9, 1.8):
        np.testing.assert_allclose(COSTS.resting_w(np.full(2, rest_s))[0], 6.0)
    np.testing.assert_allclose(COSTS.resting_w(np.full(2, 18.0))[0], 0.1 * 6 + 0.9 * 0.5)


def test_falling_asleep_and_waking_are_not_deep() -> None:
    asleep = np.zeros((100, 2), dtype=bool)
    asleep[10:50, 0] = True
    deep = COSTS.deep(asleep, 0.1)
    assert np.flatnonzero(deep[:, 0]).tolist() == list(range(14, 36))
    asleep[40:45, 0] = False  # the second rest is too short to be one
    deep = COSTS.deep(asleep, 0.1)
    assert np.flatnonzero(deep[:, 0]).tolist() == list(range(14, 26))
    asleep[60:, 0] = True  # of this rest the end cuts off the waking
    deep = COSTS.deep(asleep, 0.1)
    assert np.flatnonzero(deep[:, 0]).tolist() == [*range(14, 26), *range(64, 100)]


BOARDS = {board.name: board for board in load_boards()}


def figure(value: float) -> Figure:
    return Figure(value=value, source="a test", date="2026")


def test_each_figure_has_a_source_and_a_date_and_no_board_is_missing() -> None:
    wanted = {
        "jetson-orin-nano-7w", "jetson-orin-nano-15w", "pi-5", "pi-5-ai-camera", "pi-5-hailo-8l",
        "pi-zero-2w-ai-camera", "oak-d-rvc2", "oak-4", "n100", "grove-vision-ai-v2",
    }  # fmt: skip
    assert wanted <= {*BOARDS}
    for name in wanted:
        board = BOARDS[name]
        for each in (board.idle, board.busy, board.sleep, board.wake):
            assert each is None or (len(each.source) > 5 and "20" in each.date)
        if board.idle and board.busy:
            assert board.idle.value <= board.busy.value
        if board.idle and board.sleep:
            assert board.sleep.value <= board.idle.value
    assert BOARDS["n100"].idle is None is BOARDS["n100"].busy


def test_a_smaller_error_needs_more_looks_and_more_people_too() -> None:
    for cameras in {reach.cameras for reach in reaches(1, 60.0)}:
        looks = [
            next((r.active for r in reaches(1, mm) if r.cameras == cameras), 99.0)
            for mm in (60.0, 40.0, 30.0, 25.0)
        ]
        assert looks == sorted(looks)
    for reach in reaches(3, 40.0):
        assert reach.active < reach.cameras and reach.error_mm <= 40.05
    assert reaches(2, 40.0) == reaches(3, 40.0), "the next larger number that was measured"
    assert reaches(1, 1.0) == []
    with pytest.raises(InputError, match="expected 1 to 6, as measured"):
        reaches(7, 40.0)


def test_watts_and_hours_follow_from_the_share_of_looks() -> None:
    known = Board(name="a", title="a", idle=figure(2.0), busy=figure(6.0))
    (row,) = plan([known], 1, 40.0, 50.0)
    assert row.reach is not None
    watts = 2.0 + 4.0 * row.reach.active / row.reach.cameras
    assert row.watts == pytest.approx((watts, watts))
    assert row.hours == pytest.approx((50 / watts, 50 / watts)) and hours_text(row).endswith(" h")
    (idle,) = plan([replace(known, busy=None)], 1, 40.0, 50.0)
    assert idle.hours == (None, 25.0) and hours_text(idle) == "at most 25 h"
    (busy,) = plan([replace(known, idle=None)], 1, 40.0, 50.0)
    assert hours_text(busy) == f"at least {50 / 6:.3g} h"
    (none,) = plan([Board(name="n", title="n")], 1, 40.0, 50.0)
    assert hours_text(none) == "unknown" and none.watts == (None, None)
    (mains,) = plan([known], 1, 40.0, None)
    assert hours_text(mains) == "mains"
    (small,) = plan([replace(known, poses=False)], 1, 40.0, 50.0)
    assert hours_text(small) == "no network of several people"
    (far,) = plan([known], 1, 1.0, 50.0)
    assert far.reach is None and hours_text(far) == "out of reach"


def test_a_sensor_that_detects_has_to_look_more() -> None:
    plain = Board(name="a", title="a", idle=figure(2.0), busy=figure(6.0))
    rows = plan([plain, replace(plain, name="b", detects=True)], 1, 45.0, 50.0, cameras=4)
    by_name = {row.board.name: row for row in rows}
    ours, sensor = by_name["a"].reach, by_name["b"].reach
    assert ours is not None and sensor is not None and sensor.active > ours.active
    assert sensor == next(r for r in reaches(1, 45.0 / SENSOR_ERROR) if r.cameras == 4)


def test_the_verb_shows_all_boards_with_their_sources_and_a_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture, table = tmp_path / "plan.svg", tmp_path / "plan.json"
    words = ["power", "plan", "--people", "3", "--error", "40mm", "--battery", "50Wh"]
    assert run(*words, "--picture", str(picture), "--json", str(table)) == 0
    shown = capsys.readouterr().out
    for name, board in BOARDS.items():
        assert name in shown
        for each in (board.idle, board.busy):
            assert each is None or each.source in shown
    assert "unknown" in shown and " h" in shown
    assert picture.read_text().startswith("<?xml") and "hours" in picture.read_text()
    assert {row["board"]["name"] for row in json.loads(table.read_text())} == {*BOARDS}
    assert run("power", "plan", "--battery", "50 apples") == 2
