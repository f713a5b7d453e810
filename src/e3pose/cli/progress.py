"""Progress bars on standard error, so that standard output stays clean."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

T = TypeVar("T")


def track_progress(items: Iterable[T], total: int | None, label: str) -> Iterator[T]:
    """Yield `items` while a bar shows how far the work is; silent without a terminal."""
    from rich.console import Console
    from rich.progress import track

    console = Console(stderr=True)
    with _compiling_said(console):
        yield from track(
            items, description=label, total=total, console=console, disable=not console.is_terminal
        )


@contextmanager
def _compiling_said(console: Console) -> Iterator[None]:
    """Say on a terminal, once, that kernels are compiled, for a minute in which no bar moves."""
    if "numba" not in sys.modules or not console.is_terminal:
        yield
        return
    from numba.core import event

    class Notice(event.Listener):  # type: ignore[misc]  # untyped
        """Prints at the first kernel that is not in the cache on disk."""

        said = False

        def on_start(self, event: Any) -> None:
            if not self.said:
                self.said = True
                console.print("Compiling for this machine: once, one to two minutes.", style="dim")

        def on_end(self, event: Any) -> None:
            """Nothing: the bar goes on."""

    with event.install_listener("numba:compile", Notice()):
        yield


@contextmanager
def stage_progress() -> Iterator[tuple[Progress, Callable[[str, int, int], None]]]:
    """Yield bars, and what takes a stage's name, its steps done and in all; silent in a pipe."""
    from rich.console import Console
    from rich.progress import Progress, TaskID

    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def advance(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=total)
            bar.update(tasks[stage], completed=done, total=total)

        yield bar, advance
