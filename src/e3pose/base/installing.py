"""The command that installs an extra here: by name, or from the folder that this install is of."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

from e3pose.base.quantities import shell

FOLDERS = {"lab": "lab", "train": "lab", "hub": "hub"}  # of extras that are other distributions


@cache
def install_command(extra: str) -> str:
    """Return the command that installs an extra, such as `pip install 'e3pose[lab]'`."""
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        origin = distribution("e3pose").read_text("direct_url.json")  # PEP 610
    except PackageNotFoundError:
        origin = None
    url = urlsplit(json.loads(origin)["url"] if origin else "")
    folder = Path(url2pathname(url.path))
    if url.scheme != "file" or not (folder / "pyproject.toml").is_file():
        return f"pip install 'e3pose[{extra}]'"
    part = f" {shell(folder / FOLDERS[extra])}" if extra in FOLDERS else ""
    return f"pip install {shell(f'{folder}[{extra}]')}{part}"


def not_installed(name: str | None, extra: str) -> str:
    """Return the message on a module of an extra that is not installed."""
    return f"{name} is not installed: {install_command(extra)}"
