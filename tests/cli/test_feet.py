"""A skeleton with feet from a recording to a store, a report and exports."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.cli.commands import run
from tests.output.exports.feet import (
    NEAR_M,
    assert_feet_are_drawn,
    assert_feet_are_exported,
    error_of_feet_m,
)

from e3pose.store import Store

pytestmark = pytest.mark.slow


def test_feet_are_replayed_stored_and_exported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    feet, store, page = (tmp_path / name for name in ("feet", "live.db", "page.html"))
    scene = ("--people", 2, "--seconds", 6, "--fps", 20, "--cameras", 4, "--seed", 701)
    assert run("simulate", feet, *scene, "--skeleton", "body25") == 0
    words = ("--policy", "round-robin", "--cameras", 3, "--store", store, "--report", page)
    assert run("replay", feet, *words) == 0, capsys.readouterr().err
    assert error_of_feet_m(store, feet, Store(store).query().slots) < NEAR_M
    assert_feet_are_exported(store)
    assert_feet_are_drawn(page, "body25")
