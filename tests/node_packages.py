"""Packages of other communities that judge what we write, run by Node."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

INSTALL_S, RUN_S = 120, 60


def installed(folder: Path, packages: Sequence[str]) -> Path:
    """Install npm packages into a folder and return it; skip where that cannot be."""
    npm = shutil.which("npm")
    if npm is None or shutil.which("node") is None:
        pytest.skip("there is no Node on this machine")
    command = [npm, "install", "--silent", "--no-audit", "--no-fund", "--prefix", str(folder)]
    try:
        done = subprocess.run([*command, *packages], capture_output=True, timeout=INSTALL_S)
    except subprocess.TimeoutExpired:
        pytest.skip("no package index answers npm")
    if done.returncode:
        pytest.skip("no package index answers npm")
    return folder


def node(folder: Path, script: str, *words: object) -> str:
    """Run a script with the packages of a folder; return what it prints."""
    file = folder / "script.js"
    file.write_text(script)
    command = ["node", str(file), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=RUN_S)
    assert done.returncode == 0, done.stderr
    return done.stdout
