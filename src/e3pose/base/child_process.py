"""Start programs in a group of their own, ask them to end, and kill them with all of theirs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import IO

PASSES = sys.platform != "win32"  # whether a program can be given an open socket


def start_detached(
    command: Sequence[str],
    stdin: int,
    stdout: int | IO[bytes],
    stderr: int | IO[bytes],
    environment: Mapping[str, str] | None = None,
    last: bool = False,
    passed: Sequence[int] = (),
) -> subprocess.Popen[bytes]:
    """Start a program that a Ctrl-C at our terminal does not reach.

    Args:
        command: its words.
        stdin: as of `subprocess.Popen`.
        stdout: likewise.
        stderr: likewise.
        environment: ours if None.
        last: whether all other programs come before it.
        passed: handles of sockets that it shares with us; see `PASSES`.
    """
    if sys.platform == "win32":
        flags = subprocess.CREATE_NEW_PROCESS_GROUP
        flags |= subprocess.IDLE_PRIORITY_CLASS if last else 0
        return subprocess.Popen(
            command, stdin=stdin, stdout=stdout, stderr=stderr, env=environment, creationflags=flags
        )
    process = subprocess.Popen(
        command, stdin=stdin, stdout=stdout, stderr=stderr, env=environment, start_new_session=True,
        pass_fds=passed,
    )  # fmt: skip
    if last:
        with suppress(OSError):  # it may be over already
            os.setpriority(os.PRIO_PROCESS, process.pid, 19)
    return process


def ask_to_end(process: subprocess.Popen[bytes]) -> None:
    """Ask a program that was started apart to end, as Ctrl-C would."""
    if sys.platform == "win32":
        process.send_signal(signal.CTRL_BREAK_EVENT)
    else:
        process.send_signal(signal.SIGINT)


def kill_all(process: subprocess.Popen[bytes]) -> None:
    """End a program that was started apart, and everything that it started, at once."""
    with suppress(OSError):
        if sys.platform == "win32":
            subprocess.run(
                ["taskkill", "/T", "/F", "/PID", str(process.pid)], capture_output=True, check=False
            )
        else:
            os.killpg(process.pid, signal.SIGKILL)
