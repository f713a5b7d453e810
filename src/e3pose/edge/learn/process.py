"""The trainer's process: start, watch and end it."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import msgspec

from e3pose.base.atomic import write_file
from e3pose.base.child_process import kill_all, start_detached
from e3pose.edge.learn.job import COMPLAINTS, JOB, Job

TRAINER = (sys.executable, "-m", "e3pose.edge.learn.trainer")
MAX_COMPLAINT = 300
# One thread each: the processor belongs to the edge.
SINGLE = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


class TrainerProcess:
    """One training in a process of its own, in a session of its own.

    Args:
        folder: emptied, then the place of the job and of its result.
        job: what to do.
        command: runs a trainer when given the folder as last argument.
    """

    def __init__(self, folder: Path, job: Job, command: Sequence[str] = TRAINER) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        self.folder, self.job = folder, job
        write_file(folder / JOB, msgspec.json.encode(job))
        with (folder / COMPLAINTS).open("wb") as complaints:
            self.process = start_detached(
                [*command, str(folder)],
                subprocess.DEVNULL,
                subprocess.DEVNULL,
                complaints,
                {**os.environ, **SINGLE},
                last=True,
            )

    @property
    def pid(self) -> int:
        """The process."""
        return self.process.pid

    def code(self) -> int | None:
        """Return its exit code, negative for a signal; None while it runs."""
        return self.process.poll()

    def how_it_ended(self) -> str:
        """Return one line about a process that ended."""
        code = self.process.returncode
        if code < 0:
            try:
                how = f"was killed by {signal.Signals(-code).name}"
            except ValueError:
                how = f"was killed by signal {-code}"
        else:
            how = f"ended with code {code}"
        said = self._last_complaint()
        return f"{how}: {said}" if said else how

    def kill(self) -> None:
        """Kill it and all its children."""
        kill_all(self.process)
        with suppress(subprocess.TimeoutExpired):  # stuck in the kernel: not worth waiting for
            self.process.wait(timeout=5.0)

    def _last_complaint(self) -> str:
        try:
            with (self.folder / COMPLAINTS).open("rb") as file:
                file.seek(max(0, file.seek(0, os.SEEK_END) - 4096))
                lines = file.read().decode("utf-8", errors="replace").split("\n")
        except OSError:
            return ""
        last = next((line for line in reversed(lines) if line.strip()), "")
        return "".join(c if c.isprintable() else " " for c in last)[:MAX_COMPLAINT]
