"""A simulated scene with its films, as `e3pose simulate --videos` writes it."""

from __future__ import annotations

from pathlib import Path

from tests.cli.commands import run


def film(folder: Path, cameras: int, seconds: float, seed: int) -> Path:
    """Write a recording of two people at 10 fps, 640x480, with its videos; return its folder."""
    words = ("--people", 2, "--cameras", cameras, "--seconds", seconds, "--fps", 10, "--seed", seed)
    assert run("simulate", folder, *words, "--resolution", "640x480", "--videos") == 0
    return folder
