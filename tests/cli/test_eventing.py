"""`e3pose events test` on recordings; tests/live has it beside a site that runs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.cli.commands import run

from e3pose.recording import save_recording
from e3pose.simulate import SceneSettings, simulate

pytestmark = pytest.mark.slow


def saved(folder: Path, people: int = 1) -> Path:
    """Save 16 s of a home in which somebody falls after ten."""
    scene = SceneSettings("home-fall", people=people, seconds=16.0, fps=12.5, cameras=2)
    save_recording(simulate(scene, 1), folder / "home")
    return folder / "home"


def test_a_recorded_fall_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("events", "test", saved(tmp_path), "--json", tmp_path / "seen.json") == 0
    said = capsys.readouterr().out
    assert "is lying on the floor" in said and "FALL begun: Person " in said
    seen = json.loads((tmp_path / "seen.json").read_text())
    (fall,) = (one for one in seen["told"] if one["kind"] == "fall")
    assert 1.9 < (fall["time_ns"] - fall["start_ns"]) / 1e9 < 3.5
    assert seen["result"] == "A fall or a long lie was reported."


def test_an_empty_room_says_so_and_ends_with_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("events", "test", saved(tmp_path, people=0), "--json", "-") == 1
    seen = json.loads(capsys.readouterr().out)
    assert seen["told"] == [] and "Nobody was seen" in seen["result"]
