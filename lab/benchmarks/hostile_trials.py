"""Trials of verbs on one hostile input: exit code, time and memory."""

from __future__ import annotations

import contextlib
import io
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.cli import main as e3pose

LIMIT_S = 60.0  # of CPU, for a verb; init measures for seconds
LIMIT_MB = 600.0  # more than before: a frame of the largest size takes 200 MB in RGB
NO_ERRORS = "e3pose: warning: ", "e3pose: compiling"


@dataclass(frozen=True)
class Trial:
    """Result of one verb on one input.

    Attributes:
        name: of the input.
        verb: what was given it.
        code: exit code; 0 where it was used.
        said: the line on standard error, or what was made of the input.
        took_s: seconds of CPU.
        grown_mb: memory beyond that before, at most.
    """

    name: str
    verb: str
    code: int
    said: str
    took_s: float
    grown_mb: float

    @property
    def held(self) -> bool:
        """Whether it ended as it must."""
        lines = [s for s in self.said.splitlines() if not s.startswith(NO_ERRORS)]
        ended = self.code == 0 or (self.code == 2 and len(lines) == 1)
        return ended and self.took_s < LIMIT_S and self.grown_mb < LIMIT_MB


def tried(name: str, verb: str, words: list[str]) -> Trial:
    """Run a verb in this process."""

    def run() -> str:
        stderr = io.StringIO()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(stderr):
            try:
                e3pose(words)
            except SystemExit as ended:
                if ended.code:
                    raise Ended(int(ended.code), stderr.getvalue()) from None
        return "used"

    return measured(name, verb, run)


class Ended(Exception):
    """A verb ended with a code and words."""


def measured(name: str, verb: str, run: Callable[[], str]) -> Trial:
    """Run a function and return the trial: its exit code, time and memory."""
    Path("/proc/self/clear_refs").write_text("5")  # the peak of memory from here on
    before_mb = peak_mb()
    begun_s = time.process_time()
    code = 0
    try:
        said = run()
    except Ended as ended:
        code, said = ended.args
    except InputError as error:
        code, said = 2, str(error)
    except Exception as error:  # what this looks for
        code, said = -1, f"{type(error).__name__}: {error}"
    took_s = time.process_time() - begun_s
    return Trial(name, verb, code, said, took_s, peak_mb() - before_mb)


def peak_mb() -> float:
    """Return the most memory that this process had since the peak was reset."""
    status = Path("/proc/self/status").read_text()
    (line,) = (line for line in status.splitlines() if line.startswith("VmHWM"))
    return float(line.split()[1]) / 1024
