"""Ways to break a file of a folder."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

Break = Callable[[Path], object]


def new(name: str, old: str, text: str) -> Break:
    def change(folder: Path) -> None:
        content = (folder / name).read_text()
        assert old in content, name
        (folder / name).write_text(content.replace(old, text, 1))

    return change


def ahead(name: str, line: str) -> Break:
    """Put a line in front of a TOML file."""
    return lambda folder: (folder / name).write_text(f"{line}\n{(folder / name).read_text()}")


def whole(name: str, content: str | bytes) -> Break:
    data = content.encode() if isinstance(content, str) else content
    return lambda folder: (folder / name).write_bytes(data)


def cut(name: str, end: int = 60) -> Break:
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:end])


def sparse(name: str) -> Break:
    return lambda folder: os.truncate(folder / name, 10 * 2**30)


def gone(name: str) -> Break:
    return lambda folder: (folder / name).unlink()


def instead(name: str, make: Callable[[Path], object]) -> Break:
    def change(folder: Path) -> None:
        (folder / name).unlink()
        make(folder / name)

    return change


def nested(name: str) -> Break:
    def change(folder: Path) -> None:
        with closing(sqlite3.connect(folder / name)) as store:
            store.execute("UPDATE runs SET joints = ?", ("[" * 100_000,))
            store.commit()

    return change
