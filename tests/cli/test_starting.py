"""`e3pose init` makes a site of what is there, in the words of whoever types it."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run
from tests.detectors.test_chooser import NAPPER
from tests.rigs import looking

from e3pose.detectors import make_detector
from e3pose.detectors.timing import DetectionTimes, Workload
from e3pose.output.report.overlay import write_movie
from e3pose.recording.calibration import save_rig
from e3pose.settings.site_file import load_site

pytestmark = pytest.mark.slow


def measured(workloads: Sequence[Workload]) -> DetectionTimes:
    """A detection takes 0.3 s here; to measure it takes a process for each camera."""
    make_detector(workloads[0].detector)
    return DetectionTimes(np.full(len(workloads), 0.3), np.full(len(workloads), 0.3))


@pytest.fixture
def films(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Four films of a second, in a folder that is the current one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("E3POSE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("e3pose.cli.starting.find_devices", dict)
    monkeypatch.setattr("e3pose.cli.starting.time_detections", measured)
    (tmp_path / "napper.py").write_text(NAPPER)
    for number in range(4):
        level = 0 if number == 3 else 128
        image = np.full((48, 64, 3), level, dtype=np.uint8)
        write_movie(tmp_path / f"c{number}.mp4", [image] * 10, 10.0)
    return tmp_path


def test_site_is_made_of_films(films: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("init", "room", "c0.mp4", "c1.mp4", "c2.mp4", "c3.mp4", "--detector")
    assert run(*words, "napper.py:Napper") == 0
    said = capsys.readouterr()
    assert f"c0: {films / 'c0.mp4'}, 64 x 48 at 10 frames per second" in said.out
    assert "camera c3: its picture is dark" in said.err
    assert "Missing: the calibration" in said.out
    assert "  e3pose record room walk --for 60\n" in said.out
    site = load_site(films / "room")
    assert site.name == "room" and 0 < site.fps <= 10 and site.loop.num_selected == 2
    assert [camera.id for camera in site.camera] == ["c0", "c1", "c2", "c3"]
    assert run(*words, "napper.py:Napper") == 2
    assert "folder exists" in capsys.readouterr().err


def test_calibration_names_the_cameras(films: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_rig(looking((4, 0), (0, 4)), films / "calib.toml")
    more = ("--calibration", "calib.toml", "--detector", "napper.py:Napper")
    assert run("init", "room", "c0.mp4", "c2.mp4", *more) == 2
    assert "found camera c2, expected one of c0, c1" in capsys.readouterr().err
    assert run("init", "room", "c0.mp4", "c1.mp4", *more) == 2
    assert "found images of 64 x 48, expected 1000 x 800" in capsys.readouterr().err


class Terminal(io.StringIO):
    """Somebody who types."""

    def isatty(self) -> bool:
        return True


def test_terminal_is_asked_for_cameras_and_other_sources(
    films: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("e3pose.cli.starting.find_devices", lambda: {"usb:0": "a webcam"})
    monkeypatch.setattr("sys.stdin", Terminal("n\nc0.mp4\nc1.mp4\n\n"))
    assert run("init", "room", "--detector", "napper.py:Napper") == 0
    said = capsys.readouterr().out
    assert "found usb:0: a webcam" in said and "use usb:0? [Y/n]" in said
    sources = [camera.source or "" for camera in load_site(films / "room").camera]
    assert [Path(source).name for source in sources] == ["c0.mp4", "c1.mp4"]


def test_terminal_that_is_closed_is_one_line(
    films: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", Terminal("c0.mp4\n"))
    assert run("init", "room", "--detector", "napper.py:Napper") == 2
    assert "SOURCE: the input ended" in capsys.readouterr().err
    assert not (films / "room").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "SOURCE: found 0 cameras on this machine, expected two or more sources"),
        (("c0.mp4", "none.mp4"), "camera none: .*none.mp4: found no file"),
        (("0", "1"), "expected usb:0 for /dev/video0"),
        (("c0.mp4", "c1.mp4", "--detector", "eyes"), "eyes"),
        (("c0.mp4", "c1.mp4", "--cameras", "0"), "--cameras: found 0"),
    ],
)
def test_what_is_missing_is_one_line(
    films: Path,
    words: tuple[str, ...],
    message: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    more = () if "--detector" in words else ("--detector", "napper.py:Napper")
    assert run("init", "room", *words, *more) == 2
    err = [line for line in capsys.readouterr().err.splitlines() if line.startswith("e3pose: ")]
    assert len(err) == 1
    assert re.search(message, err[0]), err
    assert not (films / "room").exists()


def test_network_that_is_not_installed_names_the_command(
    films: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("E3POSE_OFFLINE", "1")
    assert run("init", "room", "c0.mp4", "c1.mp4") == 2
    err = capsys.readouterr().err
    assert "network: found none here: " in err and "expected e3pose models pull NAME" in err
