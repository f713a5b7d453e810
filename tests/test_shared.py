"""Tests of real recordings and networks skip where there are none."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.nightly  # collects them twice in processes

ROOT = Path(__file__).parents[1]
MARKED = sorted(
    str(path)
    for path in (ROOT / "tests").rglob("test_*.py")
    if "pytest.mark.shared" in path.read_text() and path != Path(__file__)
)


@pytest.mark.parametrize(("value", "files"), [("", MARKED[::2]), (None, MARKED[1::2])])
def test_without_real_recordings_their_tests_skip(
    value: str | None, files: list[str], tmp_path: Path
) -> None:
    environment = {k: v for k, v in os.environ.items() if k != "E3POSE_SHARED"}
    if value is not None:
        environment["E3POSE_SHARED"] = value
    command = [sys.executable, "-m", "pytest", "-q", "-m", "shared", "-p", "no:cacheprovider"]
    assert len(MARKED) > 10
    done = subprocess.run(
        [*command, f"--basetemp={tmp_path / 'base'}", *files],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    last = done.stdout.strip().splitlines()[-1]
    assert "skipped" in last and "passed" not in last and "failed" not in last, last
    assert "E3POSE_SHARED is not set" in done.stdout
