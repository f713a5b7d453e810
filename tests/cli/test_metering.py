"""`power measure` leads somebody with a meter; its processes and the meter are separate ones."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.cli.commands import run

from e3pose.energy.profiles import load_profile, modes_of

WATTS = {"idle": 5.25, "looking": 9.5, "unchanged image": 6.0, "resting": 4.0}
STEP = re.compile(r"\d/4 ([a-z ]+): ")
MEASURE = (sys.executable, "-m", "e3pose", "power", "measure")


class Plug:
    """A plug that says exact watts, by HTTP."""

    def __init__(self) -> None:
        self.watts: float | None = 5.0
        plug = self

        class Answers(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(500 if plug.watts is None else 200)
                self.end_headers()
                self.wfile.write(json.dumps({"apower": plug.watts}).encode())

            def log_message(self, format: str, *args: object) -> None: ...

        self.server = HTTPServer(("127.0.0.1", 0), Answers)
        self.name = f"shelly:127.0.0.1:{self.server.server_port}"


@pytest.fixture
def plug() -> Iterator[Plug]:
    made = Plug()
    thread = threading.Thread(target=made.server.serve_forever, daemon=True)
    thread.start()
    yield made
    made.server.shutdown()
    made.server.server_close()
    thread.join()


def film(folder: Path) -> list[str]:
    """Return source, output and detector of a camera that costs nothing."""
    (folder / "images").mkdir()
    for number in range(5):
        image = np.full((48, 64, 3), 40 * number, np.uint8)
        cv2.imwrite(str(folder / "images" / f"{number}.png"), image)
    return [str(folder / "images"), str(folder / "board.toml"), "--detector", "drawn"]


class Terminal:
    """A command on a terminal of 80 columns; what it shows, and what is typed when it asks."""

    def __init__(self, *words: str) -> None:
        self.shown, self._read = "", 0
        parent, child = pty.openpty()
        env = {**os.environ, "COLUMNS": "80", "LINES": "24", "TERM": "xterm"}
        self._process = subprocess.Popen(words, stdin=child, stdout=child, stderr=child, env=env)
        os.close(child)
        self._file = parent

    def until(self, *wanted: str) -> str:
        """Return which of some words is shown first after what was waited for before."""
        end_s = time.monotonic() + 60
        while time.monotonic() < end_s:
            places = {word: self.shown.find(word, self._read) for word in wanted}
            found = {word: at for word, at in places.items() if at >= 0}
            if found:
                word = min(found, key=lambda word: found[word])
                self._read = found[word] + len(word)
                return word
            try:
                self.shown += os.read(self._file, 4096).decode()
            except OSError:  # the command has ended
                break
        raise AssertionError(f"none of {wanted} in {self.shown!r}")

    def begin(self) -> None:
        self.until("Press Enter to begin")
        self.type("")

    def type(self, words: str) -> None:
        os.write(self._file, f"{words}\n".encode())

    def end(self) -> int:
        code = self._process.wait(60)
        os.close(self._file)
        return code


def test_a_plug_is_read_step_by_step_and_a_profile_written(tmp_path: Path, plug: Plug) -> None:
    words = (*film(tmp_path), "--meter", plug.name, "--seconds", "1", "--wakes", "1")
    screen = Terminal(*MEASURE, *words)
    screen.until("5.00 W now")
    screen.begin()
    for step, watts in WATTS.items():
        screen.until(f"/4 {step}: ")
        plug.watts = watts
        screen.until(f"{watts:9.2f} W")  # live
        screen.until(f"{watts:.2f} +- 0.00 W")
    screen.until("wrote ")
    assert screen.end() == 0
    plain = re.sub(r"\x1b\[[0-9;]*m", "", screen.shown)
    lines = re.split(r"\r\n|\r\x1b\[K", plain)
    assert all(len(line) <= 80 for line in lines if str(tmp_path) not in line), lines
    modes = modes_of(load_profile(tmp_path / "board.toml"))
    idle, asleep, whole = modes.rest("idle"), modes.rest("asleep"), modes.look("whole")
    assert idle is not None and idle.watts == 5.25
    assert asleep is not None and asleep.watts == 4.0
    assert whole is not None and whole.joules == pytest.approx(4.25 * whole.latency_s)
    assert "shelly plug" in whole.source
    profile = load_profile(tmp_path / "board.toml")  # what cameras are charged by their modes
    drawn = [profile.watts(m) for m in ("active", "power-saving", "aggressive-power-saving")]
    assert drawn == pytest.approx([9.5, 5.25, 4.0])


def test_watts_of_a_display_are_typed(tmp_path: Path) -> None:
    words = (*film(tmp_path), "--meter", "display", "--seconds", "1", "--wakes", "1")
    screen = Terminal(*MEASURE, *words)
    screen.begin()
    for typed in ("none", "-3", "5,0 5.5"):
        screen.until("Watts in these seconds")
        screen.type(typed)
    screen.until("5.25 +- 0.25 W")
    for typed in ("9.5", "6", "4"):
        screen.until("Watts in these seconds")
        screen.type(typed)
    screen.until("wrote ")
    assert screen.end() == 0 and screen.shown.count("Type numbers above 0") == 2
    idle = modes_of(load_profile(tmp_path / "board.toml")).rest("idle")
    assert idle is not None and idle.watts == 5.25 and "read from a display" in idle.source


def test_without_a_terminal_nothing_is_asked_and_nonsense_is_refused_by_its_name(
    tmp_path: Path, plug: Plug, capsys: pytest.CaptureFixture[str]
) -> None:
    words, out = film(tmp_path), tmp_path / "board.toml"
    usual = ("--meter", plug.name, "--seconds", "1", "--wakes", "1", "--yes")
    for watts, more, said in (
        (5.0, usual, "5.00 +- 0.00 W when looking, no more than when idle (5.00 +- 0.00 W)"),
        (0.0, usual, "0.00 W when idle, expected more than 0 W: this computer has to draw"),
        (5.0, ("--meter", "display"), "--meter: found display, expected a terminal"),
        (5.0, ("--seconds", "0"), "--seconds"),
    ):
        plug.watts = watts
        assert run("power", "measure", *words, *more) == 2
        shown, err = capsys.readouterr()
        assert said in err.splitlines()[-1], err
        assert "Press Enter" not in shown and not STEP.search(shown)
    assert not out.exists()


def test_a_meter_that_falls_silent_is_told(tmp_path: Path, plug: Plug) -> None:
    words = (*film(tmp_path), "--meter", plug.name, "--seconds", "2", "--wakes", "1")
    screen = Terminal(*MEASURE, *words)
    screen.begin()
    screen.until("1/4 idle")
    plug.watts = None
    screen.until("one that answers until the end")
    assert screen.end() == 2 and "Traceback" not in screen.shown
    assert not (tmp_path / "board.toml").exists()
