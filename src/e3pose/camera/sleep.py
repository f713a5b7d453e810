"""Sleep of a camera: of its program alone, or of the whole machine with an alarm of its own."""

from __future__ import annotations

import shutil
import subprocess
import threading
from collections.abc import Sequence
from dataclasses import dataclass

from e3pose.base.errors import InputError, reason_of
from e3pose.base.system import require_linux
from e3pose.settings.limits import SECONDS, Sleep
from e3pose.wire.codec import one_line

SUSPEND = ("rtcwake", "-m", "mem", "-s", SECONDS)
# Alarms count whole seconds: one that goes off within the next second may pass before the machine
# is suspended, which then wakes by no alarm; more keeps machines awake that could be suspended.
LEAST_SUSPEND_S = 2.0
POLL_S = 0.1
OVERTIME_S = 600.0  # a command that takes so much longer than asked hangs


@dataclass(frozen=True, slots=True)
class Suspend:
    """Suspends the machine by a command, which returns once it is awake again.

    Attributes:
        command: its words; `{seconds}` in one of them stands for the time until the alarm.
    """

    command: tuple[str, ...] = SUSPEND

    def run(self, seconds: int, stopping: threading.Event) -> str:
        """Suspend; return why that did not work, for operators, empty if it did.

        Args:
            seconds: until the alarm.
            stopping: ends the command where the machine is not suspended after all.
        """
        words = [word.replace(SECONDS, str(seconds)) for word in self.command]
        try:
            running = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",
            )
        except OSError as error:
            return one_line(f"cannot suspend: {words[0]}: {reason_of(error)}")
        left = int((seconds + OVERTIME_S) / POLL_S)
        with running:
            while running.poll() is None and left > 0 and not stopping.wait(POLL_S):
                left -= 1
            if running.poll() is None:
                running.kill()
                return "" if stopping.is_set() else f"cannot suspend: {words[0]} does not return"
            said = "" if running.stderr is None else running.stderr.read(300)
        if running.returncode == 0:
            return ""
        return one_line(f"cannot suspend: {words[0]} exits with {running.returncode}: {said}")


def open_suspend(sleep: Sleep, command: Sequence[str]) -> Suspend | None:
    """Return the function that suspends the machine; None where its owner does not allow that.

    Args:
        sleep: what the owner allows.
        command: the owner's own; empty for `rtcwake`.

    Raises:
        InputError: when the machine cannot be suspended so.
    """
    if sleep != "suspend":
        return None
    words = tuple(command) or SUSPEND
    if words == SUSPEND:
        require_linux("sleep = 'suspend'", "a suspend_command of your own, or sleep = 'process'")
    if shutil.which(words[0]) is None:
        wanted = f"{words[0]} on the PATH"
        if not command:
            wanted += " (package util-linux), a suspend_command of your own, or sleep = 'process'"
        raise InputError("sleep", f"'suspend', and no program {words[0]}", wanted)
    return Suspend(words)
