"""Progress of compilation in this process, and its remaining time."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

# Of a first start, in units of an ordinary part: see lab/experiments/2026-11-23-first-start.md.
WEIGHTS = {"step_slot": 40.0, "predict_tracks": 20.0}
SHOWN_FROM = 0.03  # of the work; before, an estimate of the rest says little

_LOG = logging.getLogger(__name__)


def left_s(done: float, total: float, spent_s: float) -> float | None:
    """Return the seconds that the rest takes at the pace so far; None while that is unknown.

    Args:
        done: work done, in any unit.
        total: all of it.
        spent_s: seconds that it took, without what else was done between.
    """
    if total <= 0 or done < SHOWN_FROM * total:
        return None
    return spent_s * max(total - done, 0.0) / done


def progress_text(rest_s: float | None) -> str:
    """Return how long the rest takes, for people: `compiling: 40 s left`."""
    if rest_s is None:
        return "compiling for this machine, once"
    return f"compiling: {max(5 * round(rest_s / 5), 5)} s left"


class Compiling:
    """Follows the compilations of this process; `dispatcher` makes numba report them.

    Args:
        clock: seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._expected: dict[Callable[..., Any], float] = {}
        self._done: set[Callable[..., Any]] = set()
        self._begun_s: float | None = None  # of what is being compiled now, or was last
        self._spent_s = 0.0  # compiling, before that
        self._active = 0

    def expect(self, function: Callable[..., Any]) -> None:
        """Add a function that may have to be compiled."""
        self._expected[function] = WEIGHTS.get(function.__name__, 1.0)

    def skip(self, package: str, spent_s: float) -> None:
        """Count the functions of a package as compiled before, in so many seconds."""
        self._done |= {each for each in self._expected if each.__module__.startswith(package)}
        self._spent_s += spent_s

    def notify(self, event: Any) -> None:
        """Take an event of numba: a function is about to be compiled, or is compiled."""
        function = event.data["dispatcher"].py_func
        if function not in self._expected:
            return
        if event.is_end:
            self._active -= 1
            self._done.add(function)
            if not self._active and self._begun_s is not None:
                self._spent_s += self._clock() - self._begun_s
            self._log()
            return
        if not self._active:
            self._begun_s = self._clock()
        self._active += 1
        self._log()

    @property
    def active(self) -> bool:
        """Whether something is being compiled now."""
        return self._active > 0

    @property
    def begun(self) -> bool:
        """Whether something had to be compiled."""
        return self._begun_s is not None

    def left_s(self) -> float | None:
        """Return the seconds that the rest takes; None while that is unknown."""
        done = sum(self._expected[function] for function in self._done)
        spent_s = self._spent_s
        if self._active and self._begun_s is not None:
            spent_s += self._clock() - self._begun_s
        return left_s(done, sum(self._expected.values()), spent_s)

    def _log(self) -> None:
        _LOG.info(progress_text(self.left_s()))


COMPILING = Compiling()
