"""The network of a verb: the one that was asked for, else the one chooser's, fetched and said."""

from __future__ import annotations

import os
from pathlib import Path

from rich.progress import (
    BarColumn,
    DownloadColumn,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

from e3pose.base.errors import InputError
from e3pose.cli.progress import bar
from e3pose.detectors.chooser import AUTO, choose_network
from e3pose.detectors.weights import pull_weights

YES = ("1", "true", "yes", "on")
COLUMNS = (
    TextColumn("{task.description}"),
    BarColumn(),
    DownloadColumn(),
    TransferSpeedColumn(),
    TimeRemainingColumn(),
)


def fetch(name: str, index_url: str | None = None) -> Path:
    """Fetch a network by its name, with a bar; see `pull_weights`."""
    with bar(name, *COLUMNS) as progress:
        return pull_weights(name, progress, index_url)


def ready_network(asked: str, live: bool, offline: bool = False) -> str:
    """Return the network to run; for `auto` say which was chosen and why, and fetch it if need be.

    Raises:
        InputError: when none is here and none can be fetched.
    """
    if asked != AUTO:
        return asked
    choice = choose_network(live)
    if choice.installed:
        print(choice)
        return choice.name
    offline = offline or os.environ.get("E3POSE_OFFLINE", "").lower() in YES
    failed: list[str] = ["this run is offline"] if offline else []
    for name in () if offline else (choice.name, *choice.others):
        try:
            fetch(name)
        except InputError as error:
            failed.append(str(error))
            continue
        chosen = name == choice.name
        print(
            choice if chosen else f"network: {name}, the next best: {choice.name} is not to be had"
        )
        return name
    raise InputError(
        "network", f"none here: {'; '.join(failed)}", "e3pose models pull NAME, or a file of yours"
    )
