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
    "differs, reached",
    [
        ("lab/e3pose_lab/each.py", "tests/lab/test_each.py"),
        ("tests/edge/lying_site.py", "tests/edge/test_lies.py"),  # a helper
        ("tests/recording/conftest.py", "tests/recording/calibration/test_calibration_errors.py"),
        ("src/e3pose/base/arrays.py", "tests/estimate/filter/test_motion.py"),  # by others
        ("src/e3pose/edge/lead.py", "tests/site/test_up.py"),  # starts programs
        ("src/e3pose/store/query.py", "tests/store/test_retention.py"),  # a lazy package
        ("src/e3pose/site/web/static/pictures.js", "tests/live/test_view_page.py"),  # no module
        ("lab/benchmarks/claims.toml", "tests/lab/benchmarks/test_claims.py"),
        ("docs/index.md", "tests/wire/test_messages_doc.py"),  # reads pages
        ("src/e3pose/model/skeleton.py", "tests/lab/datasets/test_bvh.py"),
        ("hub/e3pose_hub/pull.py", "tests/hub/test_hub.py"),
        ("pyproject.toml", "tests/model/test_undistort.py"),
    ],
)
def test_tests_that_reach_what_differs_are_not_left_out(differs: str, reached: str) -> None:
    assert (TESTS.parent / reached).is_file()
    assert reached not in prepare.unchanged({differs})


def test_tests_that_reach_nothing_which_differs_are_left_out() -> None:
    left_out = prepare.unchanged({"src/e3pose/site/web/server.py", "README.md"})
    few = ("estimate/filter/test_motion", "model/test_undistort", "camera/test_webcam")
    assert {f"tests/{one}.py" for one in few} <= {*left_out}
    assert not any(path.startswith(("tests/cli/", "tests/live/test_faults")) for path in left_out)
    left_out = prepare.unchanged({"src/e3pose/store/outbox.py", "tests/store/test_outbox.py"})
    assert {"tests/hub/test_hub.py", "tests/lab/test_each.py"} <= {*left_out}


def test_everything_is_tested_where_nothing_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prepare, "git", lambda *words: None)
    assert prepare.base() is None
    assert prepare.unchanged(set()) == []  # main itself, as CI has it


def test_every_test_runs_in_a_part_of_make_test() -> None:
    """What starts processes of sites is in `tests/live`, whose conftest marks it."""
    for path in TESTS.rglob("test_*.py"):
        marks, folder = path.read_text(), path.relative_to(TESTS).parts[0]
        assert "pytest.mark." + "live" not in marks, path
        assert "pytest.mark." + "timed" not in marks or folder in ("live", "edge"), path
