"""What the tests themselves stand on: tables of cases, and rooms that are left out."""

from __future__ import annotations

import inspect
import os
from pathlib import Path

import pytest
from tests import prepare
from tests.cases import each_case

TESTS = Path(__file__).parent


def test_all_cases_run_and_each_that_fails_is_named() -> None:
    ran: list[int] = []

    @each_case("number, word", [(1, "one"), (2, "two"), (3, "three")])
    def fails(number: int, word: str) -> None:
        ran.append(number)
        assert number != 1 and word != "three", f"not {word}"

    with pytest.raises(pytest.fail.Exception, match="2 of 3 cases") as said:
        fails()
    assert ran == [1, 2, 3]
    assert all(f"{name}: " in str(said.value) for name in ("1-one", "3-three"))
    assert "not three" in str(said.value) and "2-two" not in str(said.value)


def test_a_case_has_its_own_folder_and_changes_nothing_for_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @pytest.mark.slow
    @each_case("number", [1, 2])
    def tries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
        assert "E3POSE_TRIED" not in os.environ
        monkeypatch.setenv("E3POSE_TRIED", str(number))
        (tmp_path / "made").mkdir()

    tries(tmp_path=tmp_path, monkeypatch=monkeypatch)
    assert [*inspect.signature(tries).parameters] == ["tmp_path", "monkeypatch"]
    assert len([*tmp_path.glob("*/made")]) == 2 and "E3POSE_TRIED" not in os.environ


def test_a_table_is_skipped_only_where_all_cases_are() -> None:
    @each_case("number", [1, 2], ids=["first", "second"])
    def skips(number: int) -> None:
        if number == 1:
            pytest.skip("not here")
        assert number == 2

    try:
        skips()
    except pytest.skip.Exception:
        pytest.fail("skipped, though a case ran")
    with pytest.raises(pytest.skip.Exception):
        each_case("number", [1])(lambda number: pytest.skip("nowhere"))()


@each_case(
    "differs, tested",
    [
        ("README.md", set()),
        ("lab/e3pose_lab/__init__.py", {"lab"}),
        ("tests/lab/test_new.py", {"lab"}),
        ("tests/live/test_hub_page.py", {"hub"}),
        ("src/e3pose/calibrate/new.py", {"calibrate"}),
        ("src/e3pose/simulate/__init__.py", {"lab", "calibrate"}),  # their tests import it
        ("src/e3pose/model/camera.py", {*prepare.ROOMS}),
        ("pyproject.toml", {*prepare.ROOMS}),
    ],
)
def test_a_room_is_tested_where_it_or_what_it_imports_differs(
    differs: str, tested: set[str]
) -> None:
    assert {*prepare.ROOMS} - {*prepare.unchanged({differs})} >= tested
    assert tested or prepare.unchanged({differs}) == [*prepare.ROOMS]


def test_everything_is_tested_where_nothing_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prepare, "git", lambda *words: None)
    assert prepare.base() is None


def test_every_test_runs_in_a_part_of_make_test() -> None:
    """What starts processes of sites is in `tests/live`, whose conftest marks it."""
    for path in TESTS.rglob("test_*.py"):
        marks, folder = path.read_text(), path.relative_to(TESTS).parts[0]
        assert "pytest.mark." + "live" not in marks, path
        assert "pytest.mark." + "timed" not in marks or folder in ("live", "edge"), path
