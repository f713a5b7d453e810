"""Call `e3pose` as the shell does."""

from __future__ import annotations

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
