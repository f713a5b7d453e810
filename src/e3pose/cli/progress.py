"""Progress bars on standard error, so that standard output stays clean."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)

T = TypeVar("T")
# Takes work done, in all (None while that is unknown), and what it is where that changes.
Report = Callable[..., None]
LINE_S = 10.0  # between two lines on a pipe


class Overall:
    """One bar over all steps of a verb, in place of the bars of the verbs that it calls.

    Attributes:
        now: that of this process, if any.
    """

    now: Overall | None = None

    def __init__(self, report: Report, steps: Mapping[str, float]) -> None:
        """Take where to report, the steps in their order, and how many seconds each may take."""
        begins = [sum([*steps.values()][:n]) for n in range(len(steps))]
        self._spans = dict(zip(steps, zip(begins, steps.values(), strict=True), strict=True))
        self._report, self._whole = report, sum(steps.values())
        self._span, self._parts, self._part = (0.0, 0.0), 1, 0

    def begin(self, name: str, parts: int = 1) -> None:
        """Begin a step, which shows as many bars one after the other as it has parts."""
        self._span, self._parts, self._part = self._spans[name], parts, 0

    def advance(self, share: float) -> None:
        """Take how much of the part is done."""
        within = min(1.0, (self._part + share) / self._parts)
        self._report(self._span[0] + self._span[1] * within, self._whole)

    def end(self) -> None:
        """End the part."""
        self._part += 1


@contextmanager
def overall(label: str, steps: Mapping[str, float]) -> Iterator[Overall]:
    """Show one bar over all steps of a verb until the end of the block; lines in a pipe."""
    columns = TextColumn(label), BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
    with bar(label, *columns, lines=True) as report:
        Overall.now = Overall(report, steps)
        try:
            yield Overall.now
        finally:
            Overall.now = None


def track_progress(items: Iterable[T], total: int | None, label: str) -> Iterator[T]:
    """Yield `items` while a bar shows how far the work is; silent without a terminal."""
    notice_compiling()
    with bar(label, transient=False) as progress:
        for done, item in enumerate(items, 1):
            yield item
            progress(done, total)


class _Notice(logging.Handler):
    """Shows on standard error how far kernels are compiled: in place on a terminal, else lines."""

    def __init__(self) -> None:
        super().__init__()
        self._next_s, self._shown = 0.0, ""

    def emit(self, record: logging.LogRecord) -> None:
        message, now_s = record.getMessage(), time.monotonic()
        # A bar of rich takes the stream over, and prints whole lines above itself.
        in_place = sys.stderr.isatty() and sys.stderr is sys.__stderr__
        if message == self._shown or (now_s < self._next_s and not in_place):
            return
        self._next_s, self._shown = now_s + LINE_S, message
        if in_place:
            print(f"\r\033[Ke3pose: {message}\r", end="", file=sys.stderr, flush=True)
        else:
            print(f"e3pose: {message}", file=sys.stderr, flush=True)


def notice_compiling() -> None:
    """Show how far kernels are compiled: meanwhile no bar moves and nothing is written."""
    log = logging.getLogger("e3pose.base.compiling")
    if not log.handlers:
        log.addHandler(_Notice())
        log.setLevel(logging.INFO)


@contextmanager
def bar(
    label: str, *columns: ProgressColumn, transient: bool = True, lines: bool = False
) -> Iterator[Report]:
    """Yield what takes work done and in all, None while that is unknown.

    Args:
        label: what the work is.
        columns: of the bar; rich's by default.
        transient: whether the bar goes when the work ends; else it stays, full.
        lines: whether to say in a pipe, every few seconds, how much is done; else it is silent.
    """
    if Overall.now is not None:
        whole = Overall.now
        yield lambda done, total, name="": whole.advance(done / total if total else 0.0)
        whole.end()
        return
    console = Console(stderr=True)
    hidden = not console.is_terminal
    begun_s = said_s = time.monotonic()
    with Progress(*columns, console=console, transient=transient, disable=hidden) as shown:
        task = shown.add_task(label, total=None)

        def progress(done: float, total: float | None, name: str = "") -> None:
            nonlocal said_s
            total = None if total is None else max(done, total)
            shown.update(task, completed=done, total=total, description=name or label)
            now_s = time.monotonic()
            if hidden and lines and done and total and now_s - said_s >= LINE_S:
                said_s, left_s = now_s, (now_s - begun_s) * (total / done - 1)
                left = f"about {left_s / 60:.0f} min left"
                print(f"{label}: {100 * done / total:.0f} %, {left}", file=sys.stderr, flush=True)

        yield progress
        total = shown.tasks[0].total or 1
        shown.update(task, completed=total, total=total)


@contextmanager
def stage_progress() -> Iterator[Callable[[str, int, int], None]]:
    """Yield what takes a stage's name, its steps done and in all; silent in a pipe."""
    notice_compiling()
    with bar("") as report:
        yield lambda stage, done, total: report(done, total, stage)
