"""Call `e3pose` as the shell does."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import pytest

from e3pose.cli import main


def run(*words: object) -> int:
    """Return the exit code of a command."""
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
        raise SystemExit(0)
    return int(ended.value.code or 0)


def refused(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """Return the one line with which a command of wrong input ends."""
    assert run(*words) == 2
    error = capsys.readouterr().err
    assert len(error.strip().splitlines()) == 1
    return error


def refused_and_unchanged(
    capsys: pytest.CaptureFixture[str], words: Sequence[str], message: str, *folders: Path
) -> None:
    """A command ends with one line and code 2, and leaves folders as they were."""
    before = [everything(folder) for folder in folders]
    capsys.readouterr()
    with pytest.raises(SystemExit) as exit_:
        main(list(words))
    out, err = capsys.readouterr()
    assert exit_.value.code == 2, (exit_.value.code, out, err)
    assert out == ""
    assert err.startswith("e3pose: ") and err.endswith("\n")
    assert len(err) < 1200
    assert err[:-1].isprintable(), "control characters, or more than one line"
    assert re.search(message, err[:-1]), err
    assert [everything(folder) for folder in folders] == before


def everything(folder: Path) -> dict[str, tuple[int, int]]:
    """Return what stands in a folder, but for what SQLite keeps beside a store that is read."""
    return {
        str(path): (path.lstat().st_size, path.lstat().st_mtime_ns if path.is_file() else 0)
        for path in sorted(folder.rglob("*"))
        if not path.name.endswith(("-wal", "-shm"))
    }
