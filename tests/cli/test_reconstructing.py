"""`e3pose reconstruct` as a user runs it, on films of a simulated scene."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from tests.cli.commands import run
from tests.simulate.filmed import film

from e3pose.base.errors import Exit

DRAWN = ("--model", "drawn")


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return film(tmp_path_factory.mktemp("films") / "films", cameras=3, seconds=4, seed=702)


def videos(films: Path) -> list[Path]:
    return sorted((films / "videos").iterdir())


def test_films_become_everything_and_again_nothing_runs(
    films: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, calibration = tmp_path / "out", tmp_path / "rig.toml"
    calibration.write_bytes((films / "calibration.toml").read_bytes())
    words = ["reconstruct", *videos(films), "--calibration", calibration, "--out", out, *DRAWN]
    assert run(*words) == 0
    said = capsys.readouterr().out
    made = {path.name for path in out.iterdir()}
    assert {"report.html", "poses.parquet", "poses.glb", "angles.csv", "recording"} <= made
    assert {path.suffix for path in out.glob("poses-track*")} == {".trc", ".mot"}
    assert "begun together" in said
    assert "Cameras that took no part: joints are " in said
    held_out = json.loads((out / "figures.json").read_text())["held_out"]
    assert len(held_out["cameras"]) == 3 and held_out["mean"]["median_mm"] < 80
    assert run(*words) == 0
    said = capsys.readouterr().out
    assert said.count(": unchanged") == 6 + ("poses.c3d" in made) and "detect: e3pose" not in said
    os.utime(calibration)  # read by every step from detect on
    assert run(*words) == 0
    assert "unchanged" not in capsys.readouterr().out
    assert run(*words, "--until", "poses", "--trim", "0s:2s") == 0
    said = capsys.readouterr().out
    assert "--max-slots" in said and "export: " not in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "FILM...: found 0, expected films of three cameras or more without --calibration"),
        (("a.mp4", "b.mp4"), "found 2, expected films of three cameras"),
        (("a.mp4", "b.mp4", "c.mp4"), "a.mp4: found no file"),
        (("a.mp4", "--calibration", "absent.toml"), "absent.toml: file not found"),
    ],
)
def test_what_cannot_be_reconstructed_is_named(
    words: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("reconstruct", *words, "--out", tmp_path / "out") == Exit.REFUSED
    assert message in capsys.readouterr().err


def test_parts_heights_and_states_are_checked(
    films: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known = ("--calibration", films / "calibration.toml", "--out", tmp_path, *DRAWN)
    for words, message in (
        (("--trim", "40s:3s"), "--trim: found '40s:3s', expected a part such as 3s:40s"),
        (("--trim", "3s"), "--trim"),
        (("--height", "171cm"), "--height: found beside --calibration"),
        (("--sync", "sound"), "has no sound"),
    ):
        assert run("reconstruct", *videos(films), *known, *words) == Exit.REFUSED
        assert message in capsys.readouterr().err
    (tmp_path / "reconstruct.toml").write_text('format = "e3pose-reconstruct"\nversion = 2\n')
    assert run("reconstruct", *videos(films), *known) == Exit.REFUSED
    assert "expected format 'e3pose-reconstruct', version 1" in capsys.readouterr().err
