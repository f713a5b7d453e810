"""Start programs in a group of their own, end them with all of theirs, and call functions apart."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from tempfile import TemporaryFile
from typing import IO, Any

from e3pose.base.errors import InputError
from e3pose.base.system import ended_by_deadline

PASSES = sys.platform != "win32"  # whether a program can be given an open socket
START_S = 15.0  # for a process of a call to start
# What is called, pickled, comes on standard input; the answer leaves as JSON on standard output,
# where nothing else may write.
CALL = """
import json, os, pickle, sys
from e3pose.base.errors import InputError
from e3pose.base.system import bound_process
answer = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)
function, arguments = pickle.load(sys.stdin.buffer)
limit_s, most_memory = float(sys.argv[1]), int(sys.argv[2])
if most_memory:
    bound_process(limit_s, most_memory)
try:
    print(json.dumps(function(*arguments)), file=answer, flush=True)
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


def start_call(
    function: Callable[..., object], *arguments: Any, limit_s: float = 0.0, most_memory: int = 0
) -> subprocess.Popen[bytes]:
    """Start to call a function of a module in a process of its own.

    Its standard error has what the function says, its standard output the answer as JSON.

    Args:
        function: to call.
        arguments: of it.
        limit_s: seconds that it may take.
        most_memory: bytes that it may take; 0 for no bounds.

    Raises:
        pickle.PicklingError, AttributeError, TypeError: where that cannot be handed over.
    """
    with TemporaryFile() as file:
        pickle.dump((function, arguments), file)
        file.seek(0)
        command = [sys.executable, "-c", CALL, str(limit_s), str(most_memory)]
        pipe = subprocess.PIPE
        return subprocess.Popen(command, stdin=file, stdout=pipe, stderr=pipe)


def call_apart(
    function: Callable[..., object], *arguments: Any, limit_s: float, most_memory: int = 0
) -> Any:
    """Call a function of a module in a process of its own, and return its answer.

    With a bound of memory the system ends the process after its time, too, so that no library in it
    need look at a clock.

    Args:
        function: to call; its answer fits into JSON.
        arguments: of it.
        limit_s: seconds that it may take.
        most_memory: bytes that it may take; 0 for no bound.

    Raises:
        InputError: that of the function, or of one that takes too much or crashes.
    """
    process = start_call(function, *arguments, limit_s=limit_s, most_memory=most_memory)
    try:
        answer, said = process.communicate(timeout=limit_s + START_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise InputError(f"took more than {limit_s:g} s") from None
    if ended_by_deadline(process.returncode):
        raise InputError(f"took more than {limit_s:g} s")
    if process.returncode != 0:
        lines = said.decode(errors="replace").strip().splitlines() or ["no memory, or a crash"]
        raise InputError(lines[-1][:500])
    return json.loads(answer)
