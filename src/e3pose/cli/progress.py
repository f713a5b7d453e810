"""Progress bars on standard error, so that standard output stays clean."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import Progress, ProgressColumn, TaskID, track

T = TypeVar("T")
LINE_S = 10.0  # between two lines on a pipe


def track_progress(items: Iterable[T], total: int | None, label: str) -> Iterator[T]:
    """Yield `items` while a bar shows how far the work is; silent without a terminal."""
    notice_compiling()
    console = Console(stderr=True)
    yield from track(
        items, description=label, total=total, console=console, disable=not console.is_terminal
    )


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
    label: str, *columns: ProgressColumn, transient: bool = True
) -> Iterator[Callable[[float, float | None], None]]:
    """Yield what takes work done and in all, None while that is unknown; silent in a pipe.

    Args:
        label: what the work is.
        columns: of the bar; rich's by default.
        transient: whether the bar goes when the work ends; else it stays, full.
    """
    console = Console(stderr=True)
    hidden = not console.is_terminal
    with Progress(*columns, console=console, transient=transient, disable=hidden) as shown:
        task = shown.add_task(label, total=None)

        def progress(done: float, total: float | None) -> None:
            total = None if total is None else max(done, total)
            shown.update(task, completed=done, total=total)

        yield progress
        total = shown.tasks[0].total or 1
        shown.update(task, completed=total, total=total)


@contextmanager
def stage_progress() -> Iterator[tuple[Progress, Callable[[str, int, int], None]]]:
    """Yield bars, and what takes a stage's name, its steps done and in all; silent in a pipe."""
    notice_compiling()
    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def advance(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=total)
            bar.update(tasks[stage], completed=done, total=total)

        yield bar, advance
