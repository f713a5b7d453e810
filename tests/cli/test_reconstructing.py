"""`e3pose reconstruct` as a user runs it, on films of a simulated scene."""

from __future__ import annotations

import errno
import json
import os
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import pytest
from tests.cli.commands import run
from tests.simulate.filmed import film

import e3pose
from e3pose.base.errors import Exit, InputError
from e3pose.cli import progress, reconstructing

DRAWN = ("--model", "drawn")


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return film(tmp_path_factory.mktemp("films") / "films", cameras=3, seconds=3, seed=702)


def videos(films: Path) -> list[Path]:
    return sorted((films / "videos").iterdir())


@pytest.fixture(scope="module")
def made(films: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[object]]:
    """What comes of the films, and the words of the command."""
    folder = tmp_path_factory.mktemp("made")
    out, calibration = folder / "out", folder / "rig.toml"
    calibration.write_bytes((films / "calibration.toml").read_bytes())
    words = ["reconstruct", *videos(films), "--calibration", calibration, "--out", out, *DRAWN]
    assert run(*words) == 0
    return out, words


def test_films_become_everything_and_again_nothing_runs(
    films: Path, made: tuple[Path, list[object]], capsys: pytest.CaptureFixture[str]
) -> None:
    out, words = made
    there = {path.name for path in out.iterdir()}
    assert {"report.html", "poses.parquet", "poses.glb", "angles.csv", "recording"} <= there
    assert {path.suffix for path in out.glob("poses-track*")} == {".trc", ".mot"}
    figures = json.loads((out / "figures.json").read_text())
    held_out = figures["held_out"]
    assert len(held_out["cameras"]) == 3 and held_out["mean"]["median_mm"] < 80
    assert figures["reprojection"]["mean"]["median_px"] < held_out["mean"]["median_px"]
    page = (out / "report.html").read_text()
    assert "<title>videos: cam0.mp4, cam1.mp4, cam2.mp4</title>" in page
    assert "How good it is" in page and "<td>left_knee</td>" in page and "<td>cam1</td>" in page
    assert "All cameras were active in every slot." in page and "class='doubt'" not in page
    assert "saved" not in page.partition("<script")[0] and "Energy per camera" not in page
    assert run(*words) == 0
    said = capsys.readouterr().out
    assert "begun together" in said and "Cameras that took no part: joints are " in said
    assert said.count(": unchanged") == 6 + ("poses.c3d" in there) and "detect: e3pose" not in said
    known = out.parent / "rig.toml"
    again = e3pose.reconstruct(*videos(films), calibration=known, out=out, model="drawn")
    assert "detect: unchanged" in capsys.readouterr().out
    assert again["held_out"] == held_out and "doubts" not in again
    with pytest.raises(InputError, match=r"FILM\.\.\.: found 1"):
        e3pose.reconstruct("a.mp4")
    with pytest.raises(InputError, match="unknown key 'hight'"):
        e3pose.reconstruct("a.mp4", hight="171cm")


def test_the_state_repeats_the_result_to_the_byte(
    made: tuple[Path, list[object]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, words = made
    again, state = tmp_path / "again", out / "reconstruct.toml"
    assert run("reconstruct", state, "--out", again) == 0
    compared = {path.name for path in out.glob("poses*")} | {"angles.csv"}
    assert {path.name for path in again.glob("poses*")} | {"angles.csv"} == compared
    for name in compared:
        assert (again / name).read_bytes() == (out / name).read_bytes(), name
    assert run("reconstruct", state, "--out", again, "--trim", "1s:2s") == Exit.REFUSED
    assert "found beside other options, expected --out alone" in capsys.readouterr().err
    changed = tmp_path / "changed.toml"
    changed.write_text(re.sub(r'(cam0\.mp4" = )(\d)', r"\g<1>1\2", state.read_text()))
    assert run("reconstruct", changed, "--out", again) == Exit.REFUSED
    assert "as when" in capsys.readouterr().err
    assert run(*words, "--until", "detect", "--trim", "0s:2s") == 0
    said = capsys.readouterr().out
    assert "--max-slots" in said and "poses: " not in said


def test_what_a_format_cannot_hold_is_left_out_of_every_run(
    films: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran, room = list[str](), OSError(errno.ENOSPC, "No space left on device")

    def command(words: list[str], **_: Any) -> None:
        dest = Path(words[words.index("--poses") + 1] if words[0] == "replay" else words[2])
        ran.append(dest.name)
        if dest.suffix == ".c3d":
            raise InputError("frames", "108000", "at most 65535")
        (dest.with_name("poses-track1.trc") if dest.suffix == ".trc" else dest).write_text("made")

    older = [tmp_path / "poses.c3d", tmp_path / "poses.trc", tmp_path / "poses-track2.trc"]
    for path in older:  # of other films
        path.write_text("older")
        os.utime(path, (0, 0))
    monkeypatch.setattr(reconstructing, "app", command)
    options = reconstructing.Options(out=tmp_path)
    for wanted in (
        ["poses.parquet", "poses.trc", "poses.mot", "poses.glb", "poses.c3d", "angles.csv"],
        ["poses.c3d"],
        ["poses.c3d"],
    ):
        ran.clear()
        steps = reconstructing.Steps(options, {"cam0": videos(films)[0]})
        reconstructing._results(steps, films, films / "calibration.toml")
        assert ran == wanted
        assert "left out poses.c3d: frames: found 108000" in capsys.readouterr().err
        assert not any(path.exists() for path in older)
        assert (tmp_path / "poses-track1.trc").read_text() == "made"

    def full(words: list[str], **_: Any) -> None:
        raise InputError("poses.c3d", "no room", "a file") from room

    monkeypatch.setattr(reconstructing, "app", full)
    steps = reconstructing.Steps(options, {"cam0": videos(films)[0]})
    with pytest.raises(InputError, match="no room"):  # the machine's fault ends it
        reconstructing._results(steps, films, films / "calibration.toml")


def test_trials_share_a_calibration_and_end_in_a_table(
    films: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trials, out = tmp_path / "trials", tmp_path / "out"
    for trial in ("left", "right"):
        (trials / trial).mkdir(parents=True)
        for film_path in videos(films):
            (trials / trial / film_path.name).symlink_to(film_path)
    (trials / "right" / "cam2.mp4").unlink()
    (trials / "right" / "cam2.mp4").write_text("no film")
    (trials / "notes").mkdir()
    common = ("--calibration", films / "calibration.toml", "--out", out, *DRAWN)
    more = ("--people", 1, "--trim", "0s:2s", "--opensim", trials / "model.osim")
    (trials / "model.osim").write_text('<Coordinate name="arm_rot_r">')
    assert run("reconstruct", trials, *common, *more, "--jobs", 1) == Exit.NO
    said = capsys.readouterr().out
    assert "held-out mm" in said and "cam2.mp4" in said and "notes" not in said
    rows = (out / "trials.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows] == ["trial", "left", "right"]
    assert rows[1].split(",")[1:4] == ["3", "20", "1"]
    assert [path.name for path in (out / "left").glob("*.trc")] == ["poses.trc"]  # of one person
    scale = (out / "left" / "opensim" / "poses-scale.xml").read_text()
    assert f"<model_file>{trials / 'model.osim'}</model_file>" in scale
    solve = (out / "left" / "opensim" / "poses-ik.xml").read_text()
    assert re.findall(r'IKCoordinateTask name="(\w+)"', solve) == ["arm_rot_r"]  # the model's own
    assert "opensim is not installed" in (out / "left" / "log.txt").read_text()
    assert "failed: " in rows[2] and "cam2.mp4" in rows[2] and "failed" not in rows[1]
    assert run("reconstruct", *videos(films), *common, "--jobs", 2) == Exit.REFUSED
    assert "expected a folder with a folder for each trial" in capsys.readouterr().err


def test_one_bar_over_all_steps_is_lines_without_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "LINE_S", 0.0)
    with progress.overall("films", {"detect": 6.0, "poses": 2.0}) as whole:
        whole.begin("detect")
        with progress.bar("frames") as report:
            report(1, 2)
        whole.begin("poses", parts=2)
        assert list(progress.track_progress([7, 8], 2, "replay")) == [7, 8]
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(",")[0] for line in lines] == [
        "films: 38 %",
        "films: 81 %",
        "films: 88 %",
    ]
    assert all(line.endswith(" min left") for line in lines)


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


@pytest.mark.nightly  # three quarters of a minute
def test_films_without_calibration_that_began_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asks = ("--people", 1, "--cameras", 4, "--seconds", 32, "--fps", 12.5, "--seed", 703)
    scene = tmp_path / "scene"
    assert run("simulate", scene, *asks, "--resolution", "640x480", "--videos") == 0
    late, paths = tmp_path / "cam1.mp4", videos(scene)
    with av.open(str(paths[1])) as film_in, av.open(str(late), "w") as film_out:
        stream: Any = film_out.add_stream("mpeg4", Fraction(25, 2), options={"qscale": "2"})
        stream.width, stream.height = 640, 480
        for number, frame in enumerate(film_in.decode(video=0)):
            if number >= 6:
                frame.pts, frame.time_base = number - 6, Fraction(2, 25)
                film_out.mux(stream.encode(frame))
        film_out.mux(stream.encode(None))
    paths[1] = late
    assert run("reconstruct", *paths, "--height", "171cm", "--out", tmp_path / "out", *DRAWN) == 0
    began = re.findall(r"^cam(\d): began at ([+-][\d.]+) s", capsys.readouterr().out, re.MULTILINE)
    apart_s = {name: float(seconds) for name, seconds in began}
    assert apart_s.pop("1") - sum(apart_s.values()) / 3 == pytest.approx(0.48, abs=0.08)  # a frame
    figures = json.loads((tmp_path / "out" / "figures.json").read_text())
    assert figures["held_out"]["mean"]["median_mm"] < 40 and "doubts" not in figures
