"""Suspending a machine: which command runs, what is said when it does not work, what is refused."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.camera.sleep import SUSPEND, Suspend, open_suspend
from e3pose.settings.camera_file import load_node


def program(folder: Path, name: str, text: str) -> str:
    file = folder / name
    file.write_text(f"#!/bin/sh\n{text}\n")
    file.chmod(0o755)
    return str(file)


def test_command_gets_the_seconds_as_words_and_no_shell_sees_them(tmp_path: Path) -> None:
    log = tmp_path / "log"
    suspend = Suspend(
        (program(tmp_path, "doze", f'printf "%s|" "$@" > {log}'), "-t", "{seconds}s; x")
    )
    assert suspend.run(7, threading.Event()) == ""
    assert log.read_text() == "-t|7s; x|"


def test_command_that_fails_says_why(tmp_path: Path) -> None:
    suspend = Suspend(
        (program(tmp_path, "rtcwake", "echo no wakeup alarm >&2; exit 1"), "{seconds}")
    )
    said = suspend.run(7, threading.Event())
    assert "exits with 1" in said and "no wakeup alarm" in said and "\n" not in said
    assert "cannot suspend" in Suspend((str(tmp_path / "gone"), "{seconds}")).run(
        7, threading.Event()
    )


def test_command_ends_with_the_camera(tmp_path: Path) -> None:
    suspend, stopping = (
        Suspend((program(tmp_path, "doze", "exec sleep 60"), "{seconds}")),
        threading.Event(),
    )
    threading.Timer(0.3, stopping.set).start()
    begun_s = time.monotonic()
    assert suspend.run(60, stopping) == ""
    assert time.monotonic() - begun_s < 30


def test_machine_without_rtcwake_is_refused_with_what_helps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match=r"no program rtcwake.*util-linux.*suspend_command"):
        open_suspend("suspend", ())
    with pytest.raises(InputError, match="no program doze"):
        open_suspend("suspend", ("doze", "{seconds}"))
    program(tmp_path, "rtcwake", "exit 0")
    assert open_suspend("suspend", ()) == Suspend(SUSPEND)
    assert open_suspend("process", ()) is None and open_suspend("off", ()) is None


CAMERA = """format = "e3pose-camera"
version = 1
site = "lab"
camera = "cam1"
source = "usb:0"
"""


def test_camera_file_says_how_it_may_sleep(tmp_path: Path) -> None:
    file = tmp_path / "cam1.toml"
    file.write_text(CAMERA)
    assert (load_node(file).sleep, load_node(file).suspend_command) == ("process", ())
    file.write_text(CAMERA + 'sleep = "suspend"\nsuspend_command = ["doze", "{seconds}"]\n')
    assert load_node(file).suspend_command == ("doze", "{seconds}")


@each_case(
    ("lines", "message"),
    [
        ('sleep = "deep"', "sleep: found 'deep'"),
        ('suspend_command = ["doze", "{seconds}"]', "suspend_command: found it with sleep"),
        ('sleep = "suspend"\nsuspend_command = ["doze"]', "suspend_command: found no .seconds."),
        ('sleep = "suspend"\nsuspend_command = "doze {seconds}"', "suspend_command: found text"),
    ],
)
def test_wrong_sleep_is_refused_by_its_key(tmp_path: Path, lines: str, message: str) -> None:
    file = tmp_path / "cam1.toml"
    file.write_text(CAMERA + lines + "\n")
    with pytest.raises(InputError, match=message):
        load_node(file)
