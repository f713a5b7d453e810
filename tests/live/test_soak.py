"""A minute of five cameras at 25 slots a second: nothing grows and nothing is lost."""

from __future__ import annotations

import subprocess

import pytest

pytestmark = pytest.mark.live


def test_nothing_grows_in_a_minute(soak: subprocess.Popen[str]) -> None:
    said, _ = soak.communicate(timeout=420)
    assert soak.returncode == 0, said
    last = said.strip().splitlines()[-1]
    assert "the edge grew by" in last and last.endswith(" 0 slots lost"), said
