"""Start programs in a group of their own, end them with all of theirs, and bound calls."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import IO

from e3pose.base.system import ended_by_deadline

PASSES = sys.platform != "win32"  # whether a program can be given an open socket
START_S = 15.0  # for a process of a bounded call to start
CALL = """
import sys
from importlib import import_module
from e3pose.base.errors import InputError
from e3pose.base.system import bound_process
module, name, argument, limit_s, most_memory = sys.argv[1:]
function = getattr(import_module(module), name)
bound_process(float(limit_s), int(most_memory))
try:
    function(argument)
except (InputError, MemoryError) as error:
    sys.exit(str(error) or "not enough memory")
"""


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


def call_apart(
    function: Callable[[str], object], argument: str, limit_s: float, most_memory: int
) -> str:
    """Call a function of a module in a process of its own; return why that failed, else nothing.

    The system ends the process after a time, so that no library in it need look at a clock.

    Args:
        function: to call; an `InputError` of it is returned.
        argument: of it.
        limit_s: seconds that it may take.
        most_memory: bytes that it may take.
    """
    named = function.__module__, function.__name__, argument, str(limit_s), str(most_memory)
    try:
        ended = subprocess.run(
            [sys.executable, "-c", CALL, *named], capture_output=True, timeout=limit_s + START_S
        )
    except subprocess.TimeoutExpired:
        return f"took more than {limit_s:g} s"
    if ended_by_deadline(ended.returncode):
        return f"took more than {limit_s:g} s"
    lines = ended.stderr.decode(errors="replace").strip().splitlines() or ["no memory, or a crash"]
    return "" if ended.returncode == 0 else lines[-1][:500]
