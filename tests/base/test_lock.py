"""One program writes at a place; others are refused by name; a killed one leaves no lock."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from e3pose.base.atomic import atomic_folder
from e3pose.base.errors import InputError
from e3pose.base.lock import hold, lock_file

HOLDER = """
import sys
from pathlib import Path
from e3pose.base.lock import hold
sys.argv = ["e3pose", "edge", "site.toml"]
with hold(Path({path!r})):
    print("held", flush=True)
    sys.stdin.read()
"""


def holder(path: Path) -> subprocess.Popen[str]:
    program = subprocess.Popen(
        [sys.executable, "-c", HOLDER.format(path=str(path))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert program.stdout is not None
    assert program.stdout.readline() == "held\n"
    return program


def test_second_program_is_reported_who_writes(tmp_path: Path) -> None:
    path = tmp_path / "live.db"
    program = holder(path)
    with program:
        message = (
            rf"live\.db: process {program.pid} \(e3pose edge site\.toml\) writes there already"
        )
        with pytest.raises(InputError, match=message), hold(path):
            pass
        (tmp_path / "link.db").symlink_to(path)
        with pytest.raises(InputError, match="writes there already"), hold(tmp_path / "link.db"):
            pass
        with hold(path, "yard"), hold(path, "../hall"):  # parts of their own
            pass
        program.send_signal(signal.SIGKILL)
    assert lock_file(path).exists(), "a killed program cannot remove it"
    with hold(path):
        pass
    assert not lock_file(path).exists()


def test_lock_is_waited_for(tmp_path: Path) -> None:
    path, done = tmp_path / "keys.toml", threading.Event()
    order: list[int] = []

    def first() -> None:
        with hold(path):
            done.set()
            threading.Event().wait(0.2)
            order.append(1)

    thread = threading.Thread(target=first)
    thread.start()
    assert done.wait(5)
    with hold(path, wait_s=10):
        order.append(2)
    thread.join()
    assert order == [1, 2]


def test_no_two_of_many_ever_hold_it(tmp_path: Path) -> None:
    path, inside, most = tmp_path / "x", [0], [0]

    def work() -> None:
        for _ in range(30):
            with hold(path, wait_s=60):
                inside[0] += 1
                most[0] = max(most[0], inside[0])
                inside[0] -= 1

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == [1]


def test_a_folder_where_nothing_may_be_written_is_no_lock(tmp_path: Path) -> None:
    with hold(tmp_path / "missing" / "x"):  # the writer gets the reason
        pass
    if os.geteuid() == 0:
        return
    tmp_path.chmod(0o500)
    try:
        with hold(tmp_path / "x"):
            pass
    finally:
        tmp_path.chmod(0o700)


def test_two_writers_of_one_recording_are_distinguished(tmp_path: Path) -> None:
    dest = tmp_path / "walk"
    with atomic_folder(dest) as folder:
        (folder / "recording.toml").write_text("first")
        message = rf"walk: process {os.getpid()} .*writes there already"
        with pytest.raises(InputError, match=message), atomic_folder(dest, overwrite=True):
            pass
    assert (dest / "recording.toml").read_text() == "first"
    assert [entry.name for entry in tmp_path.iterdir()] == ["walk"]


def test_lock_on_a_disk_that_turned_read_only_stays_and_ends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_only(*_: object, **__: object) -> None:
        raise OSError(30, "Read-only file system")

    with hold(tmp_path / "state.npz"):
        monkeypatch.setattr(Path, "unlink", read_only)
    monkeypatch.undo()
    with hold(tmp_path / "state.npz"):  # nobody holds it
        pass
    assert not lock_file(tmp_path / "state.npz").exists()
