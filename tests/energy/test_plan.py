"""The plan of boards: sources are there, arithmetic is right, unknown stays unknown."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from tests.cli.commands import run

from e3pose.base.errors import InputError
from e3pose.energy.plan import SENSOR_NOISE, Board, Figure, hours_text, load_boards, plan, reaches

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
    assert sensor == next(r for r in reaches(1, 45.0 / SENSOR_NOISE) if r.cameras == 4)


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
