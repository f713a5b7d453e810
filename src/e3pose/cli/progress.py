"""Progress bars on standard error, so that standard output stays clean."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from rich.progress import Progress

T = TypeVar("T")


def track_progress(items: Iterable[T], total: int | None, label: str) -> Iterator[T]:
    """Yield `items` while a bar shows how far the work is; silent without a terminal."""
    from rich.console import Console
    from rich.progress import track

    notice_compiling()
    console = Console(stderr=True)
    yield from track(
        items, description=label, total=total, console=console, disable=not console.is_terminal
    )


class _Notice(logging.Handler):
    """Prints messages on standard error, above a bar if there is one."""

    def emit(self, record: logging.LogRecord) -> None:
        print(f"e3pose: {record.getMessage()}", file=sys.stderr, flush=True)


def notice_compiling() -> None:
    """Print, once, that kernels are compiled: for a minute no bar moves and nothing is written."""
    log = logging.getLogger("e3pose.runtime.kernel")
    if not log.handlers:
        log.addHandler(_Notice())
        log.setLevel(logging.INFO)


@contextmanager
def stage_progress() -> Iterator[tuple[Progress, Callable[[str, int, int], None]]]:
    """Yield bars, and what takes a stage's name, its steps done and in all; silent in a pipe."""
    from rich.console import Console
    from rich.progress import Progress, TaskID

    notice_compiling()
    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def advance(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=total)
            bar.update(tasks[stage], completed=done, total=total)

        yield bar, advance
