"""The page from four video sources to live 3D, command by command, against the simulated truth."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tests.cli import commands
from tests.ports import free_port
from tests.test_docs import BY_PAGE, blocks
from tests.waiting import eventually

from e3pose.detectors.timing import time_detections
from e3pose.model.rotations import similarity
from e3pose.recording import load_recording
from e3pose.recording.calibration import load_rig
from e3pose.store import Store

PAGE = "docs/tutorial/four-cameras.md"
COMPILE_S = 240.0  # what a machine that never ran this may take
COMMAND_S = 300.0
CENTRE_M, LIVE_M = 0.25, 0.1  # in a room of eight metres, on a machine that does other things
UP = "e3pose up room"
CHECK = "e3pose check room"
# Commands that start no cameras run in this process.
HERE = ("simulate", "init", "check", "calibrate", "top", "query", "export")
MEASURE_S = 0.5  # of detecting with all cameras, which takes all cores
TRIES = 8  # it measures how quick the machine is, which may be busy


def page_commands() -> list[str]:
    """Return the commands of the page in their order."""
    return [line for block in blocks(BY_PAGE[PAGE], "") for line in block.strip().splitlines()]


def start(command: str, folder: Path) -> subprocess.Popen[str]:
    program, *words = shlex.split(command)
    assert program == "e3pose"
    return subprocess.Popen(
        [sys.executable, "-m", "e3pose", *words],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "COLUMNS": "200"},
    )


@pytest.fixture
def run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[[str], tuple[int, str]]:
    """Return what runs a command of the page, and returns its exit code and what it said."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    quickly = partial(time_detections, seconds=MEASURE_S)
    for module in ("cli.starting", "site.detector_speed"):
        monkeypatch.setattr(f"e3pose.{module}.time_detections", quickly)

    def of(command: str) -> tuple[int, str]:
        program, *words = shlex.split(command)
        if words[0] in HERE:
            assert program == "e3pose"
            code = commands.run(*words)
            return code, "".join(capsys.readouterr())
        with start(command, tmp_path) as started:
            said, _ = started.communicate(timeout=COMMAND_S)
            return started.returncode, said

    return of


@pytest.mark.nightly  # two minutes; what the page does by commands test_setup_page.py does by hand
def test_four_sources_become_live_poses(
    tmp_path: Path, run: Callable[[str], tuple[int, str]]
) -> None:
    folder = tmp_path
    page = page_commands()
    before, after = page[: page.index(UP)], page[page.index(UP) + 1 :]
    said: dict[str, str] = {}
    for number, command in enumerate(before):
        missing = command == CHECK and command in before[number + 1 :]
        for _ in range(1 if command != CHECK or missing else TRIES):
            code, said[command] = run(command)
            if code == 0:
                break
        assert code == (1 if missing else 0), f"{command}: {said[command]}"
        if command.startswith("e3pose init"):  # another site may run beside this test
            path = folder / "room" / "site.toml"
            endpoint = f"127.0.0.1:{free_port()}"
            path.write_text(re.sub(r"127\.0\.0\.1:\d+", endpoint, path.read_text()))
        if missing:
            assert "rig.toml is missing" in said[command] and "Not ready" in said[command]
    assert "Ready: 0 problems" in said[CHECK]
    check = next(said[c] for c in before if c.startswith("e3pose calibrate check"))
    stated = re.search(r"expected error of a joint: (\d+) mm in the median", check)
    assert stated is not None and 5 <= int(stated[1]) <= 80, check
    assert (folder / "error.png").stat().st_size > 1000
    assert placed_within(folder) < CENTRE_M
    with start(UP, folder) as site:
        try:
            store = folder / "room" / "live.db"
            assert eventually(lambda: store.exists() and slots(store) > 60, COMPILE_S)
            for command in after:
                code, said[command] = run(command)
                assert code == 0, f"{command}: {said[command]}"
        finally:
            site.send_signal(signal.SIGINT)
            output, _ = site.communicate(timeout=60)
    assert "Traceback" not in output, output
    assert "cam3" in said["e3pose top room --once"]
    assert "track" in said["e3pose query room --from -10s"]
    assert live_error_m(folder) < LIVE_M


def slots(store: Path) -> int:
    try:
        return len(Store(store).rows("slots"))
    except Exception:  # it is being made
        return 0


def to_truth(folder: Path) -> tuple[float, np.ndarray, np.ndarray]:
    """Return what takes the calibrated world to the simulated one, by the places of cameras."""
    found = load_rig(folder / "room" / "rig.toml")
    truth = load_recording(folder / "films").rig
    return similarity(found.centers_m, truth.centers_m)


def placed_within(folder: Path) -> float:
    """Return how far the worst camera stands from its true place, metres, sizes as they are."""
    found = load_rig(folder / "room" / "rig.toml").centers_m
    truth = load_recording(folder / "films").rig.centers_m
    scale, R, t = to_truth(folder)
    assert abs(scale - 1) < 0.08
    return float(np.linalg.norm(scale * found @ R.T + t - truth, axis=1).max())


def live_error_m(folder: Path) -> float:
    """Return the median error of live joints, in the world that fits best: its axes are free."""
    recording = load_recording(folder / "films")
    assert recording.truth is not None
    truth = recording.truth.joints_m[:, 0]
    found = Store(folder / "room" / "live.db").query()
    length_ns = round(recording.num_slots * recording.interval_s * 1e9)
    slot = found.time_ns % length_ns / 1e9 * recording.fps  # of the film, which is played in a loop
    first, share = np.floor(slot).astype(int), (slot % 1)[:, None, None]
    here, then = (truth[(first + ahead) % len(truth)] for ahead in (0, 1))
    true_m = here * (1 - share) + then * share
    joints_m = found.people.joints_m.astype(float)
    known = np.isfinite(joints_m).all(axis=-1) & np.isfinite(true_m).all(axis=-1)
    assert known.sum() > 50 * 17
    scale, R, t = similarity(joints_m[known], true_m[known])
    off = np.linalg.norm(scale * joints_m[known] @ R.T + t - true_m[known], axis=-1)
    return float(np.median(off))
